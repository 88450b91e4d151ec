"""C of a policy, built for this machine, or for microcontrollers under qemu, run and counted."""

import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

SOURCES = Path(__file__).parent / "c"
BESIDE = ("cortex-m4", "cortex-m4f")  # those on which other tools are compared
_ARM = (
    "arm-none-eabi",
    (0x0, 0x400000, 0x20000000, 0x400000),
    ("qemu-system-arm", "-M", "mps2-an386", "-semihosting"),
)
_RISC = (
    "riscv64-unknown-elf",
    (0x80000000, 0x800000, 0x80800000, 0x800000),
    ("qemu-system-riscv32", "-M", "virt", "-bios", "none", "-semihosting"),
)
# name -> compiler, where memory lies, and the machine of qemu; options of the compiler
TARGETS = {
    "cortex-m4": (_ARM, ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=soft")),
    # the same core with its floating-point unit, of single precision
    "cortex-m4f": (
        _ARM, ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
    ),
    # both run on the emulated M4, which has all of their instructions
    "cortex-m0": (_ARM, ("-mcpu=cortex-m0", "-mthumb")),
    "cortex-m3": (_ARM, ("-mcpu=cortex-m3", "-mthumb")),
    "rv32imac": (_RISC, ("-march=rv32imac", "-mabi=ilp32")),
}  # fmt: skip


def is_installed(target: str) -> bool:
    """Return whether compiler and emulator of a microcontroller are installed."""
    (tools, _, machine), _ = TARGETS[target]
    return bool(shutil.which(f"{tools}-gcc") and shutil.which(machine[0]))


def count_instructions(
    target: str, folder: Path, sources: tuple[str, ...] = ("policy.c", "codec.c")
) -> dict:
    """Instructions of a control step, mean and most; bytes of ROM, and of static memory."""
    mean, worst = _counts(target, folder, [*sources, str(SOURCES / "count.c")])
    return {
        "instructions": mean,
        "instructions_max": worst,
        **measure_size(target, folder, sources),
    }


def count_split(
    target: str, folder: Path, sources: tuple[str, ...], options: tuple[str, ...]
) -> dict:
    """Instructions of a control step on the rows of count_rows.h, mean and most; of the network.

    options  SPIKING, DENSE and FLOATS, as lab/firmware/c/count_rows.c has them
    """
    defines = [f"-D{option}" for option in options]
    wrapped = ["-Wl,--wrap=policy_net_step"] if "SPIKING" in options else []
    counts = _counts(target, folder, [*sources, *defines, str(SOURCES / "count_rows.c"), *wrapped])
    return dict(zip(("instructions", "instructions_max", "network"), counts, strict=True))


def _counts(target: str, folder: Path, words: list[str]) -> list[int]:
    """The numbers that a program prints on the emulated core."""
    return [int(word) for word in run(run_words(target, folder, words), folder).split()]


def run_words(target: str, folder: Path, words: list[str]) -> list[str]:
    """The command that runs sources on the emulated core, which it builds."""
    run([*_compiler(target), *words, *_hosted(target), "-lm", "-o", "count.elf"], folder)
    return [*TARGETS[target][0][2], "-nographic", "-icount", "shift=0", "-kernel", "count.elf"]


def measure_size(
    target: str, folder: Path, sources: tuple[str, ...], least: str = "least.c"
) -> dict:
    """Bytes of ROM, and of static memory, of the least program that has all of a policy."""
    build = [*_compiler(target), *sources]
    alone = ["--specs=picolibc.specs", "-nostartfiles", "-Wl,-e,main", "-Wl,--gc-sections"]
    words = ["-ffunction-sections", *alone, *_memory(target), str(SOURCES / least)]
    run([*build, *words, "-lm", "-o", "least.elf"], folder)
    size = run([f"{TARGETS[target][0][0]}-size", "least.elf"], folder).split()
    text, data, bss = map(int, size[6:9])
    return {"rom": text + data, "static": data + bss}


def build_shared(folder: Path, *sources: str) -> None:
    """Build timed.so for this machine, as quick as gcc makes it."""
    quick = ["-std=c99", "-O3", "-march=native", "-ffp-contract=off", "-fPIC", "-shared", "-I."]
    run(["gcc", *quick, *sources, "-lm", "-o", "timed.so"], folder)


def attempt(words: list[str], folder: Path) -> tuple[bool, str]:
    """Return whether a command succeeds, and its output."""
    ended = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
    )
    return ended.returncode == 0, ended.stdout + ended.stderr


def run(words: list[str], folder: Path) -> str:
    """The output of a command that has to succeed."""
    passed, output = attempt(words, folder)
    if not passed:
        raise RuntimeError(f"{' '.join(words)}: {output[-2000:]}")
    return output


def pipe(words: list[str], given: str = "") -> str:
    """Output of a command that has to succeed, given a text."""
    ended = subprocess.run(words, input=given, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise RuntimeError(f"{' '.join(words)[:300]}: {ended.stderr[-2000:]}")
    return ended.stdout


def _compiler(target: str) -> list[str]:
    (tools, _, _), options = TARGETS[target]
    return [f"{tools}-gcc", *options, "-std=c99", "-O2", "-ffp-contract=off", "-I."]


def _hosted(target: str) -> list[str]:
    semihost = ["--specs=picolibc.specs", "--oslib=semihost", "--crt0=hosted"]
    return [*semihost, *_memory(target)]


def _memory(target: str) -> list[str]:
    names = ("__flash", "__flash_size", "__ram", "__ram_size")
    places = TARGETS[target][0][1]
    return [f"-Wl,--defsym={n}={v:#x}" for n, v in zip(names, places, strict=True)]


def best(task: Callable[[], object]) -> float:
    """Seconds of the quickest of seven attempts."""
    spent = []
    for _ in range(7):
        begun = time.perf_counter()
        task()
        spent.append(time.perf_counter() - begun)
    return min(spent)


def in_turns(rows: list[dict], spent: Callable[[dict], float]) -> None:
    """Nanoseconds on this machine of each row's C, and in parts of the first row's.

    Rows take turns, so that what else the machine does meets all of them.
    """
    for row in rows * 5:
        row["host_ns"] = min(row.get("host_ns", np.inf), spent(row))
    for row in rows:
        row["ratio"] = row["host_ns"] / rows[0]["host_ns"]
