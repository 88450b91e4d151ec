"""Networks on emulated chips in open loop: recorded or drawn spikes in, measurements out.

Any NIR file will do; a policy and its environment are needed only to record inputs for drift.

raster_emulation      a raster through a network, on a chip or in float, and all that it cost
rasters               rasters in .npy and .npz files
drift_report          where a chip leaves the float twin
design_report         a network against the design rules of chips
rtl_backend           hardware in simulation in the place of the emulated chip, compared with it
verification          recorded traces and spikes, of emulators or silicon, against ours
framework_recordings  recordings of frameworks, against the float twin of a file; what explains them
"""
