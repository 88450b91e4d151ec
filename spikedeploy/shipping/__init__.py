"""From a run folder to a shipped policy: export, publish, and the demo of what is shipped.

An exported file is read back and compared with its policy before anything else uses it.

export_run    a run's policy as a file, compared with the policy on recorded observations
publish_run   an exported policy in the zoo, with its card, learning curve and evaluation
demo_reports  reports and films of the shipped policies on three tasks
"""
