"""Evaluation on data sets and benchmark submissions."""
