"""Policies of every format, behind one interface: what can be run, compared and played.

gait             The built-in `gait`: no policy at all, the environment's own movement with a z
gap              The built-in `gap`: a scripted driver that follows the gap in the LIDAR; nothi
nir              NIR files: spiking policies, on an emulated chip or as their float twin
onnx             ONNX files: float networks, run by ONNX Runtime on one thread
policies         The registry of policies that can be run: files, run folders and built-ins, on
random           The built-in `random`: an action drawn uniformly at every control step
run              Run folders: the best checkpoint of a training run, played in torch as it was
"""
