"""What goes wrong while a chip runs; the machine draws it (emulator.upset_backend)."""

from spikedeploy.runtime.faults.fault import Fault

STATE_FLIPS = Fault(
    meaning="membranes in which one bit flips between two timesteps, readouts' too",
    unit="probability of each membrane, a timestep",
    levels=(1e-5, 1e-4, 1e-3),
    bounds=(0.0, 1.0),
    what="membranes and timesteps",
    source="chosen; particles flip far fewer, failing memory more",
)
LOST_SPIKES = Fault(
    meaning="spikes that do not arrive, those of the input too; the neuron is reset",
    unit="probability of each spike",
    levels=(0.01, 0.05, 0.2),
    bounds=(0.0, 1.0),
    what="spikes",
    source="chosen: from rare drops to a router that is congested",
)
SPURIOUS_SPIKES = Fault(
    meaning="spikes that no neuron sent, also of the input; the neuron is not reset",
    unit="probability of each neuron and input, a timestep in which it is silent",
    levels=(1e-4, 1e-3, 1e-2),
    bounds=(0.0, 1.0),
    what="silent timesteps",
    source="chosen: at 1 ms a timestep 0.1, 1 and 10 Hz",
)
