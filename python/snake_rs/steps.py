"""The steps between points and keypoints one by one, as functions on arrays, for comparison with other implementations.

volume = snake_rs.steps.aggregate(model, points, features)            # (N, 3), (N, C) -> (C, D, H, W)
features = snake_rs.steps.interpolate(model, field.volume, queries)   # (Q, 3) -> (Q, c_dim)
saliency, in_queries, in_features = snake_rs.steps.decode(model, "saliency", queries, features)
gradient = in_queries + snake_rs.steps.interpolate_gradient(model, field.volume, queries, in_features)
positions = snake_rs.steps.refine(queries, [gradient])                # one step of Adam
kept = snake_rs.steps.suppress(positions, saliency, radius=0.05)      # (K,)

`Model.encode` and `Field.detect` compute with the same code.
"""

from ._core import aggregate, decode, interpolate, interpolate_gradient, refine, suppress

__all__ = ["aggregate", "decode", "interpolate", "interpolate_gradient", "refine", "suppress"]
