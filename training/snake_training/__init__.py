"""SNAKE keypoint fields in PyTorch: network, losses, training, evaluation and export to the weight file of snake-rs."""
