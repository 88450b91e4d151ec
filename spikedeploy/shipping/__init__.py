"""From a run folder to a file: export, reproduce, and the demo of shipped policies.

An exported file is read back and compared with its policy before anything else uses it.

exported_run    a run folder as its exported file, written where it is missing or old
sources         the file of a policy, its chip, observations of an episode
export_run      a run's policy as a file, compared with the policy on recorded observations
export_c        a policy as C, of a chip or with 8-bit weights, with what it takes
verilog         a policy as Verilog for a board; its folder; a core in simulation that drives
export_file     a network as NIR for another tool, one step in ONNX
export_program  a policy as the kit of a chip: its integers, what is expected, a script
reproduce       a recorded evaluation played again, number by number
demo_reports    pages of the shipped policies on two tasks, and an index
"""
