"""Speck 2f / DYNAP-CNN (SynSense): nine cores, one layer each, integrators without a leak."""

from runtime.limits import ENDS, SPACE, WEIGHTS, Convolutions, LayerCore, Limits

SINABS = "sinabs 3.1.3 (source read)"
KI = 1024
CORES = ((16, 64), (16, 64), (16, 64), (32, 32), (32, 32), (64, 16), (64, 16), (16, 16), (16, 16))

LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, *SPACE, "IF"),
    inputs=2 * 128 * 128,
    layer_cores=tuple(LayerCore(kernel * KI, neurons * KI) for kernel, neurons in CORES),
    convolutions=Convolutions(kernel=16, strides=(1, 2, 4, 8), channels=1024, extent=64),
    destinations=2,
    weight_max=127,
    threshold_max=(1 << 15) - 1,
    membrane_loss=(0.0, 0.0),
    sources={
        "primitives": f"{SINABS}: convolution or linear map, IAF neurons, sum pool",
        "inputs": f"{SINABS}: 128 x 128 pixels of two polarities",
        "layer_cores": f"{SINABS}: kernel and neuron memory of each core",
        "convolutions": f"{SINABS}: limits of its layers",
        "destinations": SINABS,
        "weight_max": f"{SINABS}: 8 bits with the sign",
        "threshold_max": f"{SINABS}: 16 bits with the sign",
        "membrane_loss": f"{SINABS}: no leak that depends on the membrane",
        "alone": "no way to join two is published",
    },
)
