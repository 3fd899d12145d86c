"""What checks the claims: models, oracles, wrong variants, the report card."""
