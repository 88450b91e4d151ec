"""The gymnasium experiment: sparse spiking policies on the field's own tasks, teacher to chip.

experiment   which parts are missing, done in order
tasks        the tasks: teachers, students, and the dense PopSAN that operations are measured by
design       trainings of each task, where they are evaluated, and their small sizes
training     one training: found among finished runs, resumed, or started
evaluation   rows of one training at each place
networks     what plays: a teacher, a student or the dense network at a place, and what it did
records      rows as CSV, and back
points       the trainings of a policy at one place, against the teacher and the dense network
published    what published work reports, and from which table
tables       Markdown tables and verdicts
plot         return against operations
page         results/gymnasium.md
"""
