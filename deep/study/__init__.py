"""The paper's experiments: jobs, tables, figures."""
