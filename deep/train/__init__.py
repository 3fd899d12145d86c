"""Algorithm 2: a task policy trained behind the correction, and the baselines."""
