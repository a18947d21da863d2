"""Evaluation of keypoint detectors: repeatability, semantic consistency, and registration by the rules of 3DMatch.

    python -m snake_training.evaluation repeatability DATA --methods compact mine.safetensors iss --coverage 0.14 -o results/

`run` and `scenes` have the three evaluations as functions; the metrics in `repeatability`, `semantic` and `registration` are functions on
arrays. It needs snake_rs, NumPy, SciPy, pandas and, for curves, matplotlib, and no PyTorch.
"""
