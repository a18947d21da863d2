"""snake_rs in five minutes. Run it with `python docs/tutorial.py` and read along.

It needs only numpy and snake_rs.
"""

from pathlib import Path

import numpy as np

import snake_rs

# 1. A cloud is an array of points, (N, 3), in any unit and any frame. It can be read from a file, as here, or be a
#    numpy array, a torch tensor, an Open3D or a trimesh cloud.
points = snake_rs.read_points(Path(__file__).parents[1] / "samples" / "plane.ply")
size = np.ptp(points, axis=0).max()
print(f"1. A model plane of {len(points)} points, {size:.2f} long")

# 2. One call finds the keypoints of the cloud: positions that are found again in another scan of the same object.
keypoints = snake_rs.detect(points)
print(f"2. {keypoints}")

# 3. Keypoints come best first. Saliency is the score of a keypoint; occupancy is the probability that it lies on the
#    surface.
for position, saliency, nearest in zip(keypoints.points[:3], keypoints.saliency, keypoints.nearest_index):
    print(f"3. saliency {saliency:.3f} at {position.round(3)}, nearest to point {nearest}")

# 4. Options default to the values that the model recommends. Lengths are in the cloud's units, or text such as "6r":
#    six times the mean distance between neighbouring points.
sparse = snake_rs.detect(points, max_keypoints=20, nms_radius="6r")
print(f"4. {len(sparse)} keypoints that are farther apart")

# 5. Keypoints come from a field. Encode a cloud once, then query the field anywhere in space, also between the points.
model = snake_rs.Model.builtin()
field = model.encode(points)
on_surface, far_away = field.occupancy(points).mean(), field.occupancy(points + 0.3 * size).mean()
saliency, gradient = field.saliency_and_gradient(keypoints.points)
print(f"5. occupancy {on_surface:.2f} on the points, {far_away:.2f} off them; the gradients are {gradient.shape}")

# 6. A second view of the plane has other points, a rotation and a translation. Are its keypoints at the same points?
angle = np.radians(20)
t_2_1 = np.eye(4)  # maps view 1 to view 2
t_2_1[:3, :3] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
t_2_1[:3, 3] = [2, -1, 0.5]
view_1, view_2 = points[::2], points[1::2] @ t_2_1[:3, :3].T + t_2_1[:3, 3]
found_1, found_2 = snake_rs.detect(view_1, model), snake_rs.detect(view_2, model)


def share_found_again(keypoints_1, keypoints_2):
    """The share of the keypoints of view 1 with one of view 2 nearer than 4 % of the size (`snake_training.evaluation` has more)."""
    moved = keypoints_1 @ t_2_1[:3, :3].T + t_2_1[:3, 3]
    distance = np.linalg.norm(moved[:, None] - keypoints_2[None], axis=2).min(axis=1)
    return (distance < 0.04 * size).mean()


share = share_found_again(found_1.points, found_2.points)
print(f"6. {share:.0%} of the keypoints of view 1 are found again in view 2")

# 7. For comparison, the same figure for a classical detector.
baseline = [view[snake_rs.baselines.iss(view, count=len(found_1))[0]] for view in (view_1, view_2)]
print(f"7. {share_found_again(*baseline):.0%} of the keypoints of ISS are found again")

# 8. Keypoints serve registration: find the transform between the views without an initial pose.
registration = snake_rs.register(view_1, view_2)
error = np.abs(registration.t_target_source - t_2_1).max()
print(f"8. {registration}")
print(f"8. it differs from the true motion by {error:.4f} at most")
