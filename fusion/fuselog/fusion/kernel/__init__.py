"""The compiled part: a generated model and the filter around it, as one kernel over flat arrays."""
