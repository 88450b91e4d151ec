"""Drift of a chip from the float twin, with or without calibration before it."""

from dataclasses import dataclass
from typing import Any

from spikedeploy.emulation.drift_inputs import DriftInputs
from spikedeploy.runtime.analysis.calibration import tuned, with_calibrated_headroom
from spikedeploy.runtime.analysis.drift import Drift
from spikedeploy.runtime.analysis.drift import drift as measured
from spikedeploy.runtime.analysis.spike_distance import TAU
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.convention import Convention


@dataclass(frozen=True)
class DriftReport:
    """A drift, and what it was measured on.

    policy      as the user named it
    convention  of the file
    inputs      where they come from
    calibrated  inputs of the calibration, in words; empty without one
    drift       the measurement
    """

    policy: str
    convention: Convention
    inputs: str
    calibrated: str
    drift: Drift

    def as_json(self) -> dict[str, Any]:
        """The fields as plain data."""
        return {
            "policy": self.policy,
            "convention": self.convention.to_record(),
            "inputs": self.inputs,
            "calibrated": self.calibrated or None,
            **self.drift.as_json(),
        }


def drift_report(
    policy: str,
    artifact: Artifact,
    on: Chip,
    inputs: DriftInputs,
    quantisation: Quantisation = PLAIN,
    headroom: bool = False,
    tune: bool = False,
    tau: float = TAU,
    limits: bool = True,
) -> DriftReport:
    """Calibrate on half of the inputs and measure on the rest; without calibration on all.

    headroom  choose scales at which nothing overflows on the calibration inputs
    tune      choose clipping and thresholds that bring each layer nearest to the float twin
    tau       [timesteps] time constant of the van Rossum distance
    limits    refuse what breaks a design rule of the chip
    """
    calibrated = ""
    if headroom or tune:
        first, inputs = inputs.halves()
        calibrated = first.source
        if tune:
            quantisation = tuned(artifact, on, first.raster, quantisation, tau, first.episodes)
        if headroom:
            quantisation = with_calibrated_headroom(
                artifact, on, first.raster, quantisation, first.episodes
            )
    found = measured(artifact, on, inputs.raster, quantisation, tau, limits, inputs.episodes)
    return DriftReport(policy, artifact.convention, inputs.source, calibrated, found)
