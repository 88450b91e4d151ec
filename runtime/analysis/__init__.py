"""Analysis: where a chip differs from the float twin, and why.

activity         The activity of a network: spikes and membranes of every layer, in the units o
calibration      Calibration: scales and thresholds that are chosen on recorded inputs
diagnosis        Diagnosis: layers that never spike or nearly always do, and the likely cause
drift            Drift: what a chip does otherwise than the float twin, where it begins, and wh
"""
