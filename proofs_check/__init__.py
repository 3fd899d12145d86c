"""Every statement of the paper, established as strongly as it can be: `pytest proofs_check`."""
