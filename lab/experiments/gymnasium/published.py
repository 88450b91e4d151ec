"""What published work reports on these tasks, as far as it could be read; nothing from memory."""

from dataclasses import dataclass

from spikedeploy.reports.table import ABSENT, markdown_text


@dataclass(frozen=True)
class PublishedNumber:
    """A number of a table.

    work     method and paper
    env      id of the task there
    value    mean return
    spread   standard deviation over runs; None where there is none
    source   table, and version of the paper
    """

    work: str
    env: str
    value: float
    spread: float | None
    source: str


# numbers that were read in the tables themselves: none yet, see LEFT_OUT
NUMBERS: tuple[PublishedNumber, ...] = ()

# what the abstracts say, and what could not be read
CLAIMS = (
    (
        "PopSAN (Tang et al. 2020, CoRL, [arXiv:2010.09635v1](https://arxiv.org/abs/2010.09635))",
        "Hopper, HalfCheetah, Ant and Walker2d; in [its code](https://github.com/combra-lab/"
        "pop-spiking-deep-rl) 256-256 neurons and 10 a dimension; on Loihi",
        "abstract: 140 times less energy an inference than the float actor on a Jetson TX2, at the "
        "same performance",
    ),
    (
        "Proxy Target (Xu et al. 2025, NeurIPS, "
        "[arXiv:2505.24161v3](https://arxiv.org/abs/2505.24161v3))",
        "Ant-v4, HalfCheetah-v4, Walker2d-v4, Hopper-v4, InvertedDoublePendulum-v4 (README of its "
        "code); in float, no chip",
        "abstract: up to 32 % more return than the same spiking networks without it; LIF neurons "
        "above the float actor",
    ),
)
LEFT_OUT = """\
The returns in the papers' own tables are left out: neither table could be read when this page was
written, and numbers are not quoted from memory or from third parties."""
DIFFERENCES = """\
Set-ups differ, so that returns are not comparable number by number. Here: version 5 of the tasks,
whose rewards and observations are not those of earlier versions (Ant-v5 observes 105 numbers,
contact forces among them); observations normalised with mean and standard deviation of the
teacher's episodes and clipped at 4 of these; one teacher seed, at most three of students. There:
spiking actors trained from scratch by reinforcement learning. Here a float teacher is trained by
SAC (CartPole: PPO) and imitated, so the share of the teacher says what spiking, pruning and the
chip cost, not what reinforcement learning of a spiking network reaches."""


def published() -> str:
    """The table of numbers, if there are any, and of claims; what is left out, and why."""
    claims = markdown_text([["work", "tasks and set-up", "what it says"], *map(list, CLAIMS)])
    return "\n\n".join([*([_numbers()] if NUMBERS else []), claims, LEFT_OUT, DIFFERENCES])


def _numbers() -> str:
    lines = [["work", "task", "return", "source"]]
    for each in NUMBERS:
        spread = "" if each.spread is None else f" ± {each.spread:,.0f}"
        lines.append([each.work, each.env or ABSENT, f"{each.value:,.0f}{spread}", each.source])
    return markdown_text(lines)
