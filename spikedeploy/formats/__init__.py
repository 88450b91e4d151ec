"""The formats in which a policy may come, a file each; `spikedeploy.policies` has the table."""
