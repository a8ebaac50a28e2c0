"""MACs and parameters: exact, and as the paper counts."""
