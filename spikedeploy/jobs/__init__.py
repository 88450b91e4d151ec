"""Jobs, pure functions of what they are given: in this process, in several, or on a cluster.

A job that fails is answered with its error, and one whose worker was killed is run once more;
answers come in the order of completion. `spikedeploy.parallel` puts them in order for `compare`,
`spikedeploy.sweeps` keeps each in a file. Trainings, which take hours and checkpoint when they are
stopped, are no such jobs: spikedeploy.jobs.resumable runs those.

answer       what a job came to, and the interface of the back-ends
serial       one job after the other, in this process
processes    spawned processes of one thread each, replaced where they are killed
ray_cluster  tasks of Ray, on this machine or a cluster
resumable    trainings and parts of experiments: processes with a log each, asked to stop
resumable_process  the program that such a process runs
environment  variables of worker processes
interruption  SIGTERM as Ctrl-C
"""
