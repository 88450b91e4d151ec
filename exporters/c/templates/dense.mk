# {{ mark }}
# make test: the self-test; make lib: a shared object; make sanitize: the self-test with ASan and UBSan
CC ?= cc
CFLAGS ?= -O2
STRICT = -std=c99 -Wall -Wextra -Wpedantic -Werror -ffp-contract=off
SOURCES = {{ prefix }}.c host_i16.c
HEADERS = {{ prefix }}_i16.h

test: selftest_i16
	./selftest_i16

selftest_i16: $(SOURCES) selftest_i16.c vectors_i16.h $(HEADERS)
	$(CC) $(STRICT) $(CFLAGS) $(LDFLAGS) -o $@ $(SOURCES) selftest_i16.c -lm

sanitize: $(SOURCES) selftest_i16.c vectors_i16.h $(HEADERS)
	$(CC) $(STRICT) -g -O1 -fsanitize=address,undefined -fno-sanitize-recover=all \
		-o selftest-sanitized $(SOURCES) selftest_i16.c -lm
	./selftest-sanitized

lib: lib{{ prefix }}.so

lib{{ prefix }}.so: $(SOURCES) $(HEADERS)
	$(CC) $(STRICT) $(CFLAGS) $(LDFLAGS) -fPIC -shared -o $@ $(SOURCES) -lm

clean:
	rm -f selftest_i16 selftest-sanitized lib{{ prefix }}.so

.PHONY: test sanitize lib clean
