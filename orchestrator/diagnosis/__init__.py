"""Where a simulation departs from the real machine, which unmodelled effect causes it, how far that goes."""
