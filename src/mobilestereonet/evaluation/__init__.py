"""Evaluation on data sets and benchmark submissions."""

from mobilestereonet.evaluation.evaluate import (
    Evaluation,
    EvaluationProtocol,
    Match,
    authors_protocol,
    evaluate,
    save_evaluations,
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
    "Submission",
    "authors_protocol",
    "check_submission",
    "evaluate",
    "open_benchmark",
    "plan_submission",
    "save_evaluations",
    "write_submission",
]
