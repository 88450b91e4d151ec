"""What a chip is: a datasheet, the arithmetic that it names, and the layers that it computes.

CHIPS is the table of the chips that networks can be compiled for, each with where it stands; a new
one is a line here and a folder in runtime.families.

chip             the datasheet, the look-up by name, and the options that replace its fields
arithmetic       the one interface to everything in which the numbers of chips differ
layer            synapses, layers and their states, and when layers start
quantisation     the choices of how a float network becomes the numbers of a chip
registers        registers, what they do when they overflow, decays, and rounding
limits           what fits on a chip
damage           what is broken on it, and what goes wrong by chance while it runs
"""

CHIPS: dict[str, str] = {
    "ideal": "spikedeploy.runtime.families.cuba.arithmetic:IDEAL",
    "loihi1": "spikedeploy.runtime.families.cuba.loihi:LOIHI1",
    "loihi1-brian2": "spikedeploy.runtime.families.cuba.loihi:LOIHI1_BRIAN2",
    "loihi1-nengo": "spikedeploy.runtime.families.cuba.loihi:LOIHI1_NENGO",
    "loihi2": "spikedeploy.runtime.families.cuba.loihi:LOIHI2",
    "xylo-a2": "spikedeploy.runtime.families.xylo_datasheets:XYLO_A2",
    "xylo-a3": "spikedeploy.runtime.families.xylo_datasheets:XYLO_A3",
    "xylo-imu": "spikedeploy.runtime.families.xylo_datasheets:XYLO_IMU",
    "spinnaker2": "spikedeploy.runtime.families.cuba.arithmetic:SPINNAKER2",
    "spinnaker2-lif": "spikedeploy.runtime.families.cuba.arithmetic:SPINNAKER2_LIF",
    "speck2f": "spikedeploy.runtime.families.integrate_and_fire.layer_accelerators:SPECK2F",
    "truenorth": "spikedeploy.runtime.families.integrate_and_fire.crossbars:TRUENORTH",
    "odin": "spikedeploy.runtime.families.integrate_and_fire.crossbars:ODIN",
    "tinyodin": "spikedeploy.runtime.families.integrate_and_fire.crossbars:TINYODIN",
    "spiker": "spikedeploy.runtime.families.integrate_and_fire.layer_accelerators:SPIKER",
    "int": "spikedeploy.runtime.families.cuba.arithmetic:INT",
}
