"""The chips that networks can be compiled for; one file and one line each."""

CHIPS: dict[str, str] = {
    "ideal": "runtime.chips.ideal:IDEAL",
    "loihi1": "runtime.chips.loihi1:LOIHI1",
    "loihi1-brian2": "runtime.chips.loihi1:LOIHI1_BRIAN2",
    "loihi1-nengo": "runtime.chips.loihi1:LOIHI1_NENGO",
    "loihi2": "runtime.chips.loihi2:LOIHI2",
    "xylo-a2": "runtime.chips.xylo_a2:XYLO_A2",
    "xylo-a3": "runtime.chips.xylo_a3:XYLO_A3",
    "xylo-imu": "runtime.chips.xylo_imu:XYLO_IMU",
    "spinnaker2": "runtime.chips.spinnaker2:SPINNAKER2",
    "speck2f": "runtime.chips.speck2f:SPECK2F",
    "truenorth": "runtime.chips.truenorth:TRUENORTH",
    "odin": "runtime.chips.odin:ODIN",
    "spiker": "runtime.chips.spiker:SPIKER",
    "int": "runtime.chips.int:INT",
}
