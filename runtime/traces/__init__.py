"""Traces: recorded runs of other emulators or boards, replayed and compared.

fields           Fields: a JSON object that somebody else wrote, read by name, with errors that
loihi            Traces of Loihi, in the words of lava, brian2_loihi, nengo-loihi and of boards
sanafe           SANA-FE's energies: a network described in a sentence, and what its events add
trace_file       Trace files: what an emulator or a chip did, with everything that is needed to
verify           Verifying: a recorded run once more on our arithmetic, and the first place whe
xylo             Traces of Xylo, as xylosim's layers are built and recorded
"""
