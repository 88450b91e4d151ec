"""Experiments: tables of results/ that are filled row by row, and the pages made of them.

A new one is a module with an `Experiment`, a page in templates/, and a line in `lab.__main__`.

runner        what an experiment is, its command, its table and its page
policies      policies played in batches, with what they did
chips         a policy for every chip
clocks        sparse policies by the clock of their layers
digits        scanned digits on every chip, before and after training through it
intervals     intervals over trainings
energy        energy of spiking policies over that of float ones
own_networks  networks of one's own as policies
students      what the defaults of `distill` make of other people's teachers

Pages of results/ that are not made here say at which commit, and by which command, they were.
"""
