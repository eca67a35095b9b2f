"""FMUs looked at by themselves: what is in one, what is wrong with it, how two differ, what a step costs."""
