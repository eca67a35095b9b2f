"""Where a simulation departs from the real machine, which unmodelled effect causes it, how far that goes.

Imports `campaign` and the packages below it.
"""
