//! Reading point clouds and writing keypoints.
