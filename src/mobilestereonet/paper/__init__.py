"""The paper's tables and ablations, recomputed beside the printed figures."""
