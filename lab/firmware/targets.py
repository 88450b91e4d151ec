"""C of a policy, built for this machine, or for microcontrollers under qemu, run and counted."""

import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

SOURCES = Path(__file__).parent / "c"
_POLICY = ("policy.c", "codec.c")
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
    "rv32imac": (_RISC, ("-march=rv32imac", "-mabi=ilp32")),
}  # fmt: skip


def is_installed(target: str) -> bool:
    """Return whether compiler and emulator of a microcontroller are installed."""
    (tools, _, machine), _ = TARGETS[target]
    return bool(shutil.which(f"{tools}-gcc") and shutil.which(machine[0]))


def count_instructions(target: str, folder: Path) -> dict[str, int]:
    """Return instructions of a control step, mean and most; bytes of ROM, and of static memory."""
    words = run_words(target, folder, [*_POLICY, str(SOURCES / "count.c")])
    mean, most = map(int, run(words, folder).split())
    return {"instructions": mean, "instructions_max": most, **measure_size(target, folder)}


def run_words(target: str, folder: Path, words: list[str]) -> list[str]:
    """The command that runs sources on the emulated core, which it builds."""
    run([*_compiler(target), *words, *_hosted(target), "-lm", "-o", "count.elf"], folder)
    return [*TARGETS[target][0][2], "-nographic", "-icount", "shift=0", "-kernel", "count.elf"]


def measure_size(target: str, folder: Path) -> dict[str, int]:
    """Return bytes of ROM, and of static memory, of the least program that has all of a policy."""
    build = [*_compiler(target), *_POLICY]
    alone = ["--specs=picolibc.specs", "-nostartfiles", "-Wl,-e,main", "-Wl,--gc-sections"]
    words = ["-ffunction-sections", *alone, *_memory(target), str(SOURCES / "least.c")]
    run([*build, *words, "-lm", "-o", "least.elf"], folder)
    size = run([f"{TARGETS[target][0][0]}-size", "least.elf"], folder).split()
    text, data, bss = map(int, size[6:9])
    return {"rom": text + data, "static": data + bss}


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
