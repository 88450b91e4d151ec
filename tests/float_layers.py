import numpy as np

from spikedeploy.runtime.chips.layer import Layer, Synapses


def float_layer(weight, name, bias=0.0, threshold=1.0, voltage_bias=0.0, alpha=0.0, beta=1.0):
    """A float layer with one row of weights per axon."""
    weight = np.atleast_2d(np.asarray(weight, float))
    ones = np.ones(weight.shape[1])
    return Layer(
        name=name,
        synapses=(Synapses("input", weight, 1),),
        bias=bias * ones,
        voltage_bias=voltage_bias * ones,
        threshold=threshold * ones,
        current_decay=alpha * ones,
        membrane_decay=beta * ones,
        scale=1.0,
        start=0,
    )
