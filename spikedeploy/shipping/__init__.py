"""From a run folder to a shipped policy: export, publish, reproduce, and the demo of them.

An exported file is read back and compared with its policy before anything else uses it.

export_run           a run's policy as a file, compared with the policy on recorded observations
export_c             a policy as C of a chip, with what it takes
export_onnx          a .nir file as one step in ONNX
export_nir           a network for another tool's import, compared with the given one
export_program       a policy as the kit of a chip: its integers, what is expected, a script
export_xylo          a network as a Xylo's specification, compared with the emulated chip
exported_run         a run folder as its exported file, written where it is missing or old
training_films       films of a run while it is trained
publish_run          an exported policy in the zoo, with its card, learning curve and evaluation
card_page            the page of a card, and both written again after a new evaluation
record_fields        what a card or report has to say
recorded_evaluation  what cards and reports record, so that it can be made again
reproduce            an evaluation made again, number by number
demo_reports         pages of the shipped policies on two tasks, and an index
"""
