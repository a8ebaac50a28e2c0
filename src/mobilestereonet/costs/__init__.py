"""MACs and parameters: exact, and as the paper counts."""

from mobilestereonet.costs.count import Cost, count_costs

__all__ = ["Cost", "count_costs"]
