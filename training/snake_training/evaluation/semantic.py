"""Semantic consistency: agreement of keypoints with annotations (KeypointNet), and between two poses of a body (SMPL).

Counts are whole numbers (T, 3), a row a threshold: keypoints of the ground truth, false positives, false negatives.
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from .arrays import lengths_of, points_of, some_points

GRAPH_NEIGHBORS = 20  # of a point in the graph of geodesic distances (SNAKE section 4.1)
BODY_KEYPOINTS = 20  # of each body


def geodesic_distances(points, sources, neighbors=GRAPH_NEIGHBORS):
    """Lengths (S, N) of the shortest paths from the points of index `sources` in the undirected graph that joins each point to its
    nearest `neighbors`; infinite where there is no path.
    """
    points, sources = some_points("points", points), np.asarray(sources, int).reshape(-1)
    if neighbors < 1:
        raise ValueError(f"neighbors is {neighbors}: expected 1 or more")
    if ((sources < 0) | (sources >= len(points))).any():
        raise ValueError(f"sources: an index is outside a cloud of {len(points)} points")
    number = min(neighbors + 1, len(points))
    length, nearest = (found.reshape(len(points), number) for found in cKDTree(points).query(points, number))
    # A point with more duplicates than neighbours may not find itself: then the last one is left out.
    is_itself = nearest == np.arange(len(points))[:, None]
    is_itself[~is_itself.any(axis=1), -1] = True
    length, nearest = length[~is_itself], nearest[~is_itself]
    graph = csr_array((length, nearest, np.arange(len(points) + 1) * (number - 1)), shape=(len(points),) * 2)
    return dijkstra(graph, directed=False, indices=sources)


def semantic_counts(points, ground_truth, keypoints, thresholds, paper=False):
    """Counts of one shape (SNAKE section 4.1): keypoints (K, 3) move to the nearest point, and match an annotated point, an index in
    `ground_truth`, at a geodesic distance of at most the threshold. Several may match one.

    `paper` counts as the released code does: points without a path between them match, as its old scikit-learn gave 0.
    """
    points, keypoints = some_points("points", points), points_of("keypoints", keypoints)
    truth = np.unique(np.asarray(ground_truth, int).reshape(-1))
    snapped = cKDTree(points).query(keypoints)[1] if len(keypoints) else np.zeros(0, int)
    distance = geodesic_distances(points, truth)[:, snapped] if len(truth) else np.zeros((0, len(snapped)))
    return match_counts(np.where(np.isinf(distance) & paper, 0, distance), thresholds)


def match_counts(distance, thresholds):
    """Counts from the distances (G, K) between keypoints of the ground truth and others."""
    thresholds = lengths_of("thresholds", thresholds)
    to_truth, to_others = distance.min(axis=0, initial=np.inf), distance.min(axis=1, initial=np.inf)
    return np.array([[len(to_others), (to_truth > t).sum(), (to_others > t).sum()] for t in thresholds])


def body_pair_counts(body_1, body_2, keypoints_1, keypoints_2, thresholds, rng=None):
    """Counts of two poses of a body (SNAKE section 4.1; UKPGAN): `body_1`, `body_2` (N, 3) are the same samples of the surface.

    The best 20 keypoints of each, best first, move to the nearest sample, which is carried to the other body and matches a keypoint
    there within the threshold. Body 2 is the ground truth. With `rng`, random samples fill up fewer than 20, as in the released code.
    """
    bodies = [some_points("body_1", body_1), some_points("body_2", body_2)]
    if len(bodies[0]) != len(bodies[1]):
        raise ValueError(f"body_2: {len(bodies[1])} samples, body_1 has {len(bodies[0])}; row i is the same place")
    chosen = []
    for number, (body, keypoints) in enumerate(zip(bodies, (keypoints_1, keypoints_2)), 1):
        keypoints = points_of(f"keypoints_{number}", keypoints)[:BODY_KEYPOINTS]
        found = cKDTree(body).query(keypoints)[1] if len(keypoints) else np.zeros(0, int)
        if rng is not None:
            missing = min(BODY_KEYPOINTS - len(found), len(body))
            found = np.concatenate([found, rng.choice(len(body), missing, replace=False)])
        chosen.append(found)
    first, second = chosen
    on_1, on_2 = (cdist(body[second], body[first]) for body in bodies)
    forth, back = match_counts(on_2, thresholds), match_counts(on_1, thresholds)
    return np.column_stack([forth[:, 0], forth[:, 1], back[:, 2]])


def iou(counts):
    """Intersection over union (...,) of counts (..., 3): (truth - missed) / (truth + false); 0 without keypoints."""
    truth, false, missed = np.moveaxis(np.asarray(counts), -1, 0)
    return (truth - missed) / np.maximum(truth + false, 1)


def recall(counts):
    """Share (...,) of the ground truth with a keypoint, of counts (..., 3); 0 without ground truth."""
    truth, _, missed = np.moveaxis(np.asarray(counts), -1, 0)
    return (truth - missed) / np.maximum(truth, 1)
