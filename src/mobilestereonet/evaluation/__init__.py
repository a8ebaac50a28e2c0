"""Evaluation on data sets and benchmark submissions."""

from mobilestereonet.evaluation.evaluate import (
    Evaluation,
    EvaluationProtocol,
    Match,
    authors_protocol,
    evaluate,
    save_evaluations,
)
from mobilestereonet.evaluation.sparsification import (
    Sparsification,
    plot_sparsification,
    sparsification,
)
from mobilestereonet.evaluation.submit import (
    BENCHMARKS,
    Submission,
    check_submission,
    open_benchmark,
    plan_submission,
    write_submission,
)

__all__ = [
    "BENCHMARKS",
    "Evaluation",
    "EvaluationProtocol",
    "Match",
    "Sparsification",
    "Submission",
    "authors_protocol",
    "check_submission",
    "evaluate",
    "open_benchmark",
    "plan_submission",
    "plot_sparsification",
    "save_evaluations",
    "sparsification",
    "write_submission",
]
