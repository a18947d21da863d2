"""Draws what `register` answers: `python docs/pairs.py OUT.png SOURCE TARGET [--hypotheses 3] [--map VOXEL_SIZE] [--side]`.

Both clouds are seen from above or from the side, the target in grey and the source on top of it: the best answer first, then its rivals. With `--map` the
target is a `PreparedMap`. Needs snake_rs and Pillow.
"""

import argparse

import numpy as np

WIDTH, TITLE, MARGIN = 1000, 26, 12  # pixels
GREY, RED = (150, 150, 150), (229, 72, 77)


def panel(clouds, transform, title, width, axes):
    """The picture of source and target (N, 3) under a transform (4, 4), `width` pixels wide, along two axes."""
    from PIL import Image, ImageDraw, ImageFont

    source, target = clouds
    drawn = [(target, GREY), (source @ transform[:3, :3].T + transform[:3, 3], RED)]
    drawn = [(cloud[:, axes], colour) for cloud, colour in drawn]
    points = np.concatenate([cloud for cloud, _ in drawn])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = (width - 2 * MARGIN) / (high[0] - low[0])
    canvas = np.full((int((high[1] - low[1]) * scale) + 2 * MARGIN + TITLE, width, 3), 255, np.uint8)
    for cloud, colour in drawn:
        column = MARGIN + (cloud[:, 0] - low[0]) * scale
        row = TITLE + MARGIN + (high[1] - cloud[:, 1]) * scale
        canvas[row.astype(int), column.astype(int)] = colour
    image = Image.fromarray(canvas)
    font = ImageFont.load_default(15)
    ImageDraw.Draw(image).text((width / 2, TITLE / 2), title, fill="black", font=font, anchor="mm")
    return image


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output")
    parser.add_argument("clouds", nargs=2, metavar="CLOUD")
    parser.add_argument("--hypotheses", type=int, default=1)
    parser.add_argument("--map", type=float, metavar="VOXEL_SIZE")
    parser.add_argument("--side", action="store_true", help="seen along y instead of z")
    arguments = parser.parse_args()
    from PIL import Image

    import snake_rs

    clouds = [np.asarray(snake_rs.read_points(path)) for path in arguments.clouds]
    if arguments.map:
        result = snake_rs.PreparedMap(clouds[1], voxel_size=arguments.map).register(clouds[0])
    else:
        result = snake_rs.register(*clouds, hypotheses=arguments.hypotheses)
    answers = result.hypotheses
    width = WIDTH // max(len(answers), 2)
    titles = [f"confidence {result.verdict.confidence:.2f}"] + ["rival"] * (len(answers) - 1)
    axes = [0, 2] if arguments.side else [0, 1]
    panels = [panel(clouds, answer, title, width, axes) for answer, title in zip(answers, titles)]
    picture = Image.new("RGB", (len(panels) * width, max(image.height for image in panels)), "white")
    for i, image in enumerate(panels):
        picture.paste(image, (i * width, 0))
    picture.quantize(16).save(arguments.output, optimize=True)


if __name__ == "__main__":
    main()
