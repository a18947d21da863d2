"""The same keypoints in one frame after another: python examples/frames.py FRAME1 FRAME2 .."""

import sys

import snake_rs


def main(paths: list[str]) -> None:
    detector, before = snake_rs.FrameDetector("scenes"), None
    for path in paths:
        keypoints = detector.detect(path)
        if before is not None:
            # Rows (i, j): keypoint i before and keypoint j now, each the nearest of the other.
            pairs = snake_rs.match(before, keypoints)
            print(f"{path}: {len(pairs)} pairs with the keypoints of the frame before")
        before = keypoints


if __name__ == "__main__":
    main(sys.argv[1:])
