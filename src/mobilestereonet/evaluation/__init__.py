"""Evaluation on data sets and benchmark submissions."""

from mobilestereonet.evaluation.benchmarks import (
    BENCHMARKS,
    Benchmark,
    Submission,
    open_benchmark,
    plan_submission,
)
from mobilestereonet.evaluation.comparison import (
    PAPER_COLUMNS,
    Column,
    compare_evaluations,
    comparison_table,
    leaderboard_columns,
)
from mobilestereonet.evaluation.evaluate import (
    Evaluation,
    EvaluationProtocol,
    authors_protocol,
    evaluate,
    save_evaluations,
)
from mobilestereonet.evaluation.matching import DisparityFn
from mobilestereonet.evaluation.pareto import ParetoPoint, pareto_front, plot_pareto
from mobilestereonet.evaluation.reliability import (
    Reliability,
    confidences,
    fit_confidence,
    reliability,
)
from mobilestereonet.evaluation.report import legend
from mobilestereonet.evaluation.result_table import ResultTable, Spread
from mobilestereonet.evaluation.sparsification import (
    Sparsification,
    plot_sparsification,
    sparsification,
)
from mobilestereonet.evaluation.submit import check_submission, write_submission

__all__ = [
    "BENCHMARKS",
    "PAPER_COLUMNS",
    "Benchmark",
    "Column",
    "DisparityFn",
    "Evaluation",
    "EvaluationProtocol",
    "ParetoPoint",
    "Reliability",
    "ResultTable",
    "Sparsification",
    "Spread",
    "Submission",
    "authors_protocol",
    "check_submission",
    "compare_evaluations",
    "comparison_table",
    "confidences",
    "evaluate",
    "fit_confidence",
    "leaderboard_columns",
    "legend",
    "open_benchmark",
    "pareto_front",
    "plan_submission",
    "plot_pareto",
    "plot_sparsification",
    "reliability",
    "save_evaluations",
    "sparsification",
    "write_submission",
]
