"""Exported C is used from C++, and as C++: links, includes, names, warnings, the same numbers."""

import shutil

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.exporters.c.int8 import quantise
from spikedeploy.exporters.c.packaging import write_texts
from spikedeploy.exporters.c.to_c import mlp_in_c, network_in_c
from spikedeploy.runtime.artifact.artifact import load
from tests.c_builds import passed, run, written
from tests.exporters.test_c_int16 import NETWORKS as FLOAT_NETWORKS
from tests.exporters.test_c_int16 import walk_of
from tests.exporters.test_c_networks import FAMILIES, delayed, integrate
from tests.exporters.test_c_policies import POLICIES, walk

PAIRS = [pair for pair in (("gcc", "g++"), ("clang", "clang++")) if all(map(shutil.which, pair))]
needs_cpp = pytest.mark.skipif(not PAIRS, reason="neither g++ nor clang++ is installed")

CLEAN = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wsign-conversion")
CLEAN = (*CLEAN, "-Wcast-qual", "-Wundef", "-Werror", "-ffp-contract=off")
# what a name at file scope could be taken for
C_LIBRARY = """
    complex ctype errno fcntl fenv float inttypes iso646 limits locale math pthread search
    semaphore setjmp signal stdarg stdbool stddef stdint stdio stdlib string strings sys/mman
    sys/socket sys/stat sys/time sys/times sys/wait tgmath time unistd wchar wctype"""
CPP_LIBRARY = """
    algorithm any array atomic bitset chrono cmath complex cstdio cstdlib cstring ctime
    deque exception fstream functional future iomanip ios iostream iterator limits list locale map
    memory mutex new numeric optional queue random ratio regex set sstream stdexcept string
    string_view system_error thread tuple type_traits typeinfo unordered_map utility valarray
    variant vector unistd.h strings.h sys/time.h sys/times.h"""

POLICY, NETWORK, DENSE = ["policy.c", "codec.c"], ["policy.c"], ["policy.c", "host_i16.c"]
FORMS = {
    **{
        f"codec: {name}": ("policy", lambda folder, name=name: policy(POLICIES[name](), folder))
        for name in (
            "population",
            "random rate",
            "delta",
            "delta onto two readouts, the last",
        )
    },
    "loops with delays": ("network", lambda folder: network(delayed(0), folder)),
    **{
        f"{name}, {options}, {convention}": (
            "network",
            lambda folder, each=(name, options, convention): network(integrate(*each, 3), folder),
        )
        for name, options, convention in FAMILIES[::5]
    },
    **{
        f"float: {name}": ("dense", lambda folder, name=name: dense(name, folder))
        for name in ("kart-grid/small", "pruned, relu", "large and pruned")
    },
}


def policy(artifact, folder, prefix="policy"):
    written(artifact, folder, walk(artifact.codec, 12), prefix=prefix)


def network(program, folder):
    raster = (np.random.default_rng(0).random((2, 3, program.width)) < 0.3).astype(np.uint8)
    write_texts(network_in_c(program, raster, "a test").text, folder)


def dense(name, folder):
    found = quantise(FLOAT_NETWORKS[name]())
    write_texts(mlp_in_c(found, walk_of(found, 20, 0), "a test"), folder)


@pytest.fixture(scope="module")
def preludes(tmp_path_factory):
    """Headers that a file is compiled behind: the libraries of C, and of C++ without `std::`."""
    folder = tmp_path_factory.mktemp("preludes")
    lines = "".join(f"#include <{name}.h>\n" for name in C_LIBRARY.split())
    (folder / "c.h").write_text(lines)
    lines = "".join(f"#include <{name}>\n" for name in CPP_LIBRARY.split())
    (folder / "cpp.hpp").write_text(f"{lines}using namespace std;\n")
    # compiled once, with the flags of those that are behind it
    run("g++", "-std=gnu++17", "-DPOLICY_PROBE", "cpp.hpp", folder=folder)
    return folder


def files(folder, ending):
    """Files of an export, but for those of one kind of core."""
    return sorted(path.name for path in folder.glob(ending) if path.stem != "cycles")


@needs_cpp
@pytest.mark.parametrize("form", FORMS)
def test_every_file_is_c99_and_cpp17_without_a_warning_or_a_name_of_the_libraries(
    tmp_path, preludes, form
):
    kind, write = FORMS[form]
    write(tmp_path)
    probe = "-DPOLICY_PROBE"
    for c, cpp in PAIRS:
        run(c, "-std=c99", *CLEAN, probe, "-c", *files(tmp_path, "*.c"), folder=tmp_path)
        objects = []
        for name in files(tmp_path, "*.c"):
            objects.append(f"{name}pp.o")
            words = ["-x", "c++", "-std=c++17", *CLEAN, "-Wmissing-declarations", probe, "-c"]
            run(cpp, *words, name, "-o", objects[-1], folder=tmp_path)
    for name in files(tmp_path, "*.c"):
        named = ["-fsyntax-only", probe, "-include"]
        c_names = ["-std=gnu11", "-D_GNU_SOURCE", *named, f"{preludes}/c.h"]
        run("gcc", *c_names, name, folder=tmp_path)
        cpp_names = ["-x", "c++", "-std=gnu++17", *named, f"{preludes}/cpp.hpp"]
        run("g++", *cpp_names, name, folder=tmp_path)
    # the self-tests, all of them C++
    _, cpp = PAIRS[0]
    tests = {"policy": [*POLICY, "selftest.c"], "network": [*NETWORK, "selftest.c"]}
    sources = tests.get(kind, [*DENSE, "selftest_i16.c"])
    run(cpp, *(f"{name}pp.o" for name in sources), "-o", "tested", "-lm", folder=tmp_path)
    assert passed(tmp_path / "tested") > 0


@needs_cpp
@pytest.mark.parametrize("form", ["codec: delta", "loops with delays", "float: pruned, relu"])
def test_every_header_stands_alone_twice_and_between_headers_of_cpp(tmp_path, form):
    FORMS[form][1](tmp_path)
    for name in files(tmp_path, "*.h"):
        assert 'extern "C"' in (tmp_path / name).read_text()
        twice = f'#include "{name}"\n#include "{name}"\n'
        (tmp_path / "alone.c").write_text(f"{twice}int main(void) {{ return 0; }}\n")
        (tmp_path / "alone.cpp").write_text(f"{twice}#include <cmath>\n{twice}int main() {{}}\n")
        for c, cpp in PAIRS:
            run(c, "-std=c99", *CLEAN, "-fsyntax-only", "alone.c", folder=tmp_path)
            run(cpp, "-std=c++17", *CLEAN, "-fsyntax-only", "alone.cpp", folder=tmp_path)


MAIN = """#include "policy.h"
{include}
#include <{stdio}>
int main(void)
{{
    static double o[POLICY_OBSERVATIONS];
    policy_action_t a[POLICY_ACTIONS];
    policy_reset();
    policy_step(o, a);
    printf("%f\\n", (double)a[0]);
    return 0;
}}
"""


@needs_cpp
def test_a_program_in_cpp_links_with_objects_of_c_and_acts_as_one_in_c(tmp_path):
    policy(load(zoo.path("hexapod/sparse")), tmp_path)
    for c, cpp in PAIRS:
        run(c, "-std=c99", "-ffp-contract=off", "-c", *POLICY, folder=tmp_path)
        found = {}
        for name, compiler, stdio in (("main.c", c, "stdio.h"), ("main.cpp", cpp, "cstdio")):
            text = MAIN.format(include='#include "policy_i16.h"', stdio=stdio)
            (tmp_path / name).write_text(text)
            words = [*CLEAN, name, "policy.o", "codec.o", "-lm", "-o", "acts"]
            run(compiler, *words, folder=tmp_path)
            found[name] = run(tmp_path / "acts", folder=tmp_path)
        assert set(found.values()) == {"-0.328077\n"}


@needs_cpp
def test_two_policies_with_prefixes_of_their_own_fit_in_one_program_of_cpp(tmp_path):
    objects = []
    for prefix, name in (("left", "delta"), ("right", "random rate")):
        folder = tmp_path / prefix
        policy(POLICIES[name](), folder, prefix)
        for source in (f"{prefix}.c", "codec.c"):
            objects.append(f"{prefix}-{source}.o")
            words = ["gcc", "-std=c99", "-c", f"{prefix}/{source}", "-o", objects[-1]]
            run(*words, folder=tmp_path)
    (tmp_path / "main.cpp").write_text(
        '#include "left/left.h"\n#include "right/right.h"\n'
        "int main() { left_reset(); right_reset(); return 0; }\n"
    )
    run("g++", *CLEAN, "main.cpp", *objects, "-lm", "-o", "both", folder=tmp_path)
    run(tmp_path / "both", folder=tmp_path)
