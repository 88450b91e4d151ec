"""The choices of options are those of the runtime, which `--help` may not load."""

from typing import get_args

import pytest

from spikedeploy.commands import options
from spikedeploy.runtime import convention
from spikedeploy.runtime.chips import quantisation, registers
from spikedeploy.runtime.emulator import backend


@pytest.mark.parametrize(
    ("choices", "original"),
    [
        (options.Granularity, quantisation.Granularity),
        (options.Fraction, registers.Rounding),
        (options.HeadroomChoice, quantisation.Headroom),
        (options.AfterSpike, convention.Reset),
        (options.Decays, convention.Integrator),
        (options.States, convention.State),
        (options.SpikeCount, convention.Spikes),
        (options.LowestMembrane, convention.Floor),
        (options.Computes, backend.BackendName),
    ],
)
def test_an_option_offers_what_the_runtime_knows(choices, original):
    assert get_args(choices) == get_args(original)
