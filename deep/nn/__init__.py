"""Networks of K seeds at once, and the losses of the paper as pure functions."""
