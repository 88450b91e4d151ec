"""C of a policy, built for this machine, or for microcontrollers under qemu, run and counted."""

import shutil
import subprocess
from pathlib import Path

SOURCES = Path(__file__).parent / "firmware"
BESIDE = ("cortex-m4", "cortex-m4f")  # those on which other tools are compared
_M4_MEMORY = (0x0, 0x400000, 0x20000000, 0x400000)
_M4_MACHINE = ("qemu-system-arm", "-M", "mps2-an386", "-semihosting")
# compiler, its options, where memory lies, and the machine of qemu
TARGETS = {
    "cortex-m4": (
        "arm-none-eabi",
        ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=soft"),
        _M4_MEMORY,
        _M4_MACHINE,
    ),
    # the same core with its floating-point unit, of single precision
    "cortex-m4f": (
        "arm-none-eabi",
        ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
        _M4_MEMORY,
        _M4_MACHINE,
    ),
    # both run on the emulated M4, which has all of their instructions
    "cortex-m0": ("arm-none-eabi", ("-mcpu=cortex-m0", "-mthumb"), _M4_MEMORY, _M4_MACHINE),
    "cortex-m3": ("arm-none-eabi", ("-mcpu=cortex-m3", "-mthumb"), _M4_MEMORY, _M4_MACHINE),
    "rv32imac": (
        "riscv64-unknown-elf",
        ("-march=rv32imac", "-mabi=ilp32"),
        (0x80000000, 0x800000, 0x80800000, 0x800000),
        ("qemu-system-riscv32", "-M", "virt", "-bios", "none", "-semihosting"),
    ),
}


def present(target: str) -> bool:
    """Whether compiler and emulator of a microcontroller are installed."""
    tools, _, _, machine = TARGETS[target]
    return bool(shutil.which(f"{tools}-gcc") and shutil.which(machine[0]))


def on(target: str, folder: Path) -> dict:
    """Self-test, instructions and sizes of an export."""
    probed = ["-DPOLICY_PROBE", "policy.c", "codec.c", "selftest.c", "-o", "self.elf"]
    must([*_compiler(target), *_hosted(target), *probed, "-lm"], folder)
    passed, output = called([*_machine(target), "self.elf"], folder)
    return {"passed": passed and "0 differ" in output, **counted(target, folder)}


def counted(target: str, folder: Path, sources: tuple[str, ...] = ("policy.c", "codec.c")) -> dict:
    """Instructions of a control step, mean and most; bytes of ROM, and of static memory."""
    build = [*_compiler(target), *sources]
    hosted = [*_hosted(target), str(SOURCES / "count.c"), "-lm", "-o", "count.elf"]
    must([*build, *hosted], folder)
    mean, worst = map(int, must([*_machine(target), "count.elf"], folder).split()[:2])
    return {"instructions": mean, "instructions_max": worst, **sized(target, folder, sources)}


def split(target: str, folder: Path, sources: tuple[str, ...], options: tuple[str, ...]) -> dict:
    """Instructions of a control step on the rows of count_rows.h, mean and most; of the network.

    options: SPIKING, DENSE and FLOATS, as lab/firmware/c/count_rows.c has them.
    """
    defines = [f"-D{option}" for option in options]
    wrapped = ["-Wl,--wrap=policy_net_step"] if "SPIKING" in options else []
    build = [*_compiler(target), *sources, *defines, str(SOURCES / "count_rows.c")]
    must([*build, *_hosted(target), *wrapped, "-lm", "-o", "count.elf"], folder)
    said = must([*_machine(target), "count.elf"], folder).split()[:3]
    return dict(zip(("instructions", "instructions_max", "network"), map(int, said), strict=True))


def sized(target: str, folder: Path, sources: tuple[str, ...], least: str = "least.c") -> dict:
    """Bytes of ROM, and of static memory, of the least program that has all of a policy."""
    build = [*_compiler(target), *sources]
    alone = ["--specs=picolibc.specs", "-nostartfiles", "-Wl,-e,main", "-Wl,--gc-sections"]
    words = ["-ffunction-sections", *alone, *_memory(target), str(SOURCES / least)]
    must([*build, *words, "-lm", "-o", "least.elf"], folder)
    size = must([f"{TARGETS[target][0]}-size", "least.elf"], folder).split()
    text, data, bss = map(int, size[6:9])
    return {"rom": text + data, "static": data + bss}


def shared(folder: Path, *sources: str) -> None:
    """Build timed.so for this machine, as quick as gcc makes it."""
    quick = ["-std=c99", "-O3", "-march=native", "-ffp-contract=off", "-fPIC", "-shared", "-I."]
    must(["gcc", *quick, *sources, "-lm", "-o", "timed.so"], folder)


def called(words: list[str], folder: Path) -> tuple[bool, str]:
    """Whether a command succeeds, and its output."""
    ended = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
    )
    return ended.returncode == 0, ended.stdout + ended.stderr


def must(words: list[str], folder: Path) -> str:
    """The output of a command that has to succeed."""
    passed, output = called(words, folder)
    if not passed:
        raise RuntimeError(f"{' '.join(words)}: {output[-2000:]}")
    return output


def piped(words: list[str], given: str = "") -> str:
    """What a command that has to succeed writes when it is given a text."""
    ended = subprocess.run(words, input=given, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise RuntimeError(f"{' '.join(words)[:300]}: {ended.stderr[-2000:]}")
    return ended.stdout


def _compiler(target: str) -> list[str]:
    tools, options, _, _ = TARGETS[target]
    return [f"{tools}-gcc", *options, "-std=c99", "-O2", "-ffp-contract=off", "-I."]


def _hosted(target: str) -> list[str]:
    semihost = ["--specs=picolibc.specs", "--oslib=semihost", "--crt0=hosted"]
    return [*semihost, *_memory(target)]


def _memory(target: str) -> list[str]:
    names = ("__flash", "__flash_size", "__ram", "__ram_size")
    places = TARGETS[target][2]
    return [f"-Wl,--defsym={n}={v:#x}" for n, v in zip(names, places, strict=True)]


def _machine(target: str) -> list[str]:
    return [*TARGETS[target][3], "-nographic", "-icount", "shift=0", "-kernel"]
