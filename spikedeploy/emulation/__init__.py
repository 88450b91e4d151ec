"""Networks on emulated chips in open loop: recorded or drawn spikes in, measurements out.

Any NIR file will do; a policy and its environment are needed only to record inputs for drift.

open_loop      a raster through a network, on a chip or in float, with everything that it did
rasters        rasters in .npy and .npz files
measures       NeuroBench's numbers, memory traffic and latency of an inference
drift_inputs   inputs for a drift: a raster, random spikes, or what a policy observed
drift_report   where a chip leaves the float twin, with or without calibration
design_report  a network against the design rules of chips
recorded_spikes  what the author's framework computed, against the float twin
recorded_activity  spikes recorded on silicon, against an emulated chip
recorded_difference  the first difference of both, and its likeliest cause
trace_replay   recorded traces against the emulator's arithmetic
"""
