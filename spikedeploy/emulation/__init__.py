"""Networks on emulated chips in open loop: recorded or drawn spikes in, measurements out.

Any NIR file will do; a policy and its environment are needed only to record inputs for drift.

raster_emulation      a raster through a network, on a chip or in float, and all that it cost
rasters               rasters in .npy and .npz files
event_files           recordings of event cameras, from files of several formats
event_input           the part of a camera that a network sees, and time as timesteps
event_stream          a recording into a network: one long run in bounded memory
event_replay          such a run as pictures of all layers and curves, for pages
drift_report          where a chip leaves the float twin
design_report         a network against the design rules of chips
rtl_backend           hardware in simulation in the place of the emulated chip, compared with it
verification          recorded traces and spikes, of emulators or silicon, against ours
framework_recordings  recordings of frameworks, against the float twin of a file; what explains them
"""
