"""The paper's statements, one module a part of the paper."""
