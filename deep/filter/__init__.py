"""The safety filter that is deployed: numpy alone, as a file, around an environment."""
