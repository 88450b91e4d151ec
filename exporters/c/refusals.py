"""Refusals: programs, codes and names that are not written in C."""

import re
from collections.abc import Iterator

from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import MAX_TABLE_TIMESTEPS, PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire

_PREFIX = re.compile(r"[a-z][a-z0-9_]{0,30}")
# what PREFIX.h, PREFIX.c and libPREFIX.so, which `make lib` writes, would stand in the place of;
# of headers and functions those of C99 to C23 and of POSIX, and what these include
_MATHEMATICS = """
    acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp2 expm1 fabs
    fdim floor fma fmax fmin fmod frexp hypot ilogb ldexp lgamma llrint llround log log10 log1p
    log2 logb lrint lround modf nan nearbyint nextafter nexttoward pow remainder remquo rint round
    scalbln scalbn sin sinh sqrt tan tanh tgamma trunc"""
_TAKEN = {
    "a header of C or its systems": """
        assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal
        stdalign stdarg stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn
        string tgmath threads time uchar wchar wctype aio cpio dirent dlfcn endian fcntl fmtmsg
        fnmatch ftw glob grp iconv langinfo libgen libintl malloc memory monetary mqueue ndbm netdb
        nl_types poll pthread pwd regex sched search semaphore spawn strings stropts syslog tar
        termios trace ulimit unistd utime utmpx values wordexp alloca features""",
    "a header of Arduino": "arduino client eeprom ethernet print printable sd server servo spi "
    "stream udp wifi wire wstring",  # some file systems do not tell Arduino.h from arduino.h
    "a reserved word of C": """
        alignas alignof asm auto bool break case char const constexpr continue default do double
        else enum extern false for fortran goto if inline int long main nullptr register restrict
        return short signed sizeof static static_assert struct switch thread_local true typedef
        typeof typeof_unqual union unsigned void volatile while""",
    "a function of C": f"""
        {" ".join(name + kind for name in _MATHEMATICS.split() for kind in ("", "f", "l"))}
        memchr memcmp memcpy memmove memset strcat strchr strcmp strcoll strcpy strcspn strdup
        strerror strlen strncat strncmp strncpy strpbrk strrchr strspn strstr strtok strxfrm
        abort abs aligned_alloc at_quick_exit atexit atof atoi atol atoll bsearch calloc div exit
        free getenv labs ldiv llabs lldiv mblen qsort quick_exit rand realloc srand strtod strtof
        strtol strtold strtoll strtoul strtoull system
        clearerr fclose feof ferror fflush fgetc fgetpos fgets fopen fprintf fputc fputs fread
        freopen fscanf fseek fsetpos ftell fwrite getc getchar gets perror printf putc putchar puts
        remove rename rewind scanf setbuf setvbuf snprintf sprintf sscanf tmpfile tmpnam ungetc
        vfprintf vprintf vscanf vsnprintf vsprintf vsscanf
        isalnum isalpha isblank iscntrl isdigit isgraph islower isprint ispunct isspace isupper
        isxdigit tolower toupper longjmp raise va_arg va_copy va_end va_start
        asctime clock ctime difftime gmtime localtime mktime strftime
        accept bind close connect fork kill listen open pause pipe read recv send sleep socket
        stat write""",
    "a library of the system": "asan c crypt dl gcc gcc_s m resolv rt stdc ubsan util",
    "a file that is written beside it": """
        codec selftest vectors makefile gnumakefile codec_i16 host_i16 selftest_i16 vectors_i16
        cycles""",
    "a device on Windows": " ".join(
        ["con aux nul prn", *(f"{port}{n}" for port in ("com", "lpt") for n in range(10))]
    ),
}
_DECAY_BITS = 24


def check_program(program: Program) -> None:
    """Refuse programs whose arithmetic is not written in C."""
    arithmetic, chip = program.chip.arithmetic, program.chip.name
    if not isinstance(arithmetic, (CubaFixedPoint, IntegrateAndFire)):
        raise ConfigError(
            f"--to c: chip {chip!r} computes with {type(arithmetic).__name__}; C is written for "
            "integers of Loihi's kind and of integrate-and-fire neurons. Choose loihi1, int, "
            "truenorth, odin, tinyodin, speck2f or spiker."
        )
    if isinstance(arithmetic, CubaFixedPoint) and arithmetic.decay_bits > _DECAY_BITS:
        raise ConfigError(f"--to c: decay_bits is {arithmetic.decay_bits}; at most {_DECAY_BITS}.")
    if arithmetic.together:
        raise ConfigError(
            f"--to c: the queue of {chip!r} is on, and is not written in C. Choose queue=off, "
            "where the program relays the spikes."
        )
    if program.graded:
        raise ConfigError(
            f"--to c: layer {min(program.graded)!r}: sigma-delta neurons send graded spikes, which "
            "is not written in C. Train neurons that spike."
        )
    if program.clock == "free":
        raise ConfigError(
            "--to c: clock 'free': layers run on between their windows, as on a chip whose cores "
            "all advance, which is not written in C. Compile with clock='gated' or 'pipelined'."
        )
    if program.host:
        raise ConfigError(
            f"--to c: readout {program.host[0].name!r}: its membranes do not leave {chip}, so that "
            "the host integrates it in float, which is not written in C. Choose a chip that gives "
            "membranes out, such as loihi1."
        )
    if program.damage or program.upsets is not None:
        raise ConfigError("--to c: a chip with faults is not written in C. Leave --faults out.")
    for layer, synapses, lag in unusual_synapses(program):
        raise ConfigError(
            f"--to c: layer {layer.name!r}: the synapses from {synapses.source!r} have "
            f"shift {synapses.shift}, current {synapses.current} and lag {lag}; C is "
            "written for 0, 0 and a source that comes first."
        )


def unusual_synapses(program: Program) -> Iterator[tuple[Layer, Synapses, int]]:
    """Layer, synapses and lag of those with a shift, a second current, or a source that is late.

    One is late that is computed behind the layer, and whose spikes arrive without a lag.
    """
    seen = {program.input}
    for layer, lags in zip(program.layers, program.lags, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            is_late = lag <= 0 and synapses.source not in seen
            if synapses.shift or synapses.current or is_late:
                yield layer, synapses, lag
        seen.add(layer.name)


def check_codec(codec: Codec) -> None:
    """Refuse codes that are not written in C."""
    encoder = codec.encoder
    if not isinstance(encoder, (DeltaEncoder, RateEncoder, PopulationEncoder)):
        raise ConfigError(
            f"--to c: encoder {encoder.kind!r} is not written in C. Train with delta, rate or "
            "population."
        )
    if isinstance(encoder, PopulationEncoder) and codec.timesteps > MAX_TABLE_TIMESTEPS:
        raise ConfigError(
            f"--to c: a population code over {codec.timesteps} timesteps; its table has at most "
            f"{MAX_TABLE_TIMESTEPS}. Train with fewer."
        )


def check_prefix(prefix: str) -> None:
    """Refuse what cannot begin the names of C."""
    if not _PREFIX.fullmatch(prefix):
        raise ConfigError(
            f"--prefix {prefix[:40]!r}: names of C begin with it; choose a small letter, then "
            "small letters, digits and '_', 31 at most."
        )
    if "__" in f"{prefix}_":
        raise ConfigError(
            f"--prefix {prefix!r}: C++ reserves names with two underscores in a row, and one "
            "follows the prefix; choose another, without '__' and without '_' at its end."
        )
    for what, names in _TAKEN.items():
        if prefix in names.split():
            raise ConfigError(
                f"--prefix {prefix!r} is the name of {what}; {prefix}.h, {prefix}.c and "
                f"lib{prefix}.so would stand in its place or be taken for it. Choose another, such "
                f"as {prefix}_policy."
            )
