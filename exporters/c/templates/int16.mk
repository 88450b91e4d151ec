SOURCES_I16 = @prefix@.c codec_i16.c host_i16.c

test_i16: selftest_i16
	./selftest_i16

selftest_i16: $(SOURCES_I16) selftest_i16.c vectors_i16.h @prefix@_i16.h @prefix@.h
	$(CC) $(STRICT) $(CFLAGS) $(LDFLAGS) -o $@ $(SOURCES_I16) selftest_i16.c -lm

lib_i16: lib@prefix@_i16.so

lib@prefix@_i16.so: $(SOURCES_I16) @prefix@_i16.h @prefix@.h
	$(CC) $(STRICT) $(CFLAGS) $(LDFLAGS) -fPIC -shared -o $@ $(SOURCES_I16) -lm

.PHONY: test_i16 lib_i16
