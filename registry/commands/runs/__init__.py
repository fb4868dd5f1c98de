"""The verbs that make a run or go on with one."""
