"""The chips that networks can be compiled for; one file and one line each."""

CHIPS: dict[str, str] = {
    "ideal": "runtime.chips.ideal:IDEAL",
    "loihi1": "runtime.chips.loihi1:LOIHI1",
}
