import numpy as np
import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.sequences.files import image_files, numbered_images, ranges, stamps_in_names


def test_natural_order_without_hidden_and_other_files(tmp_path, write_images):
    write_images(tmp_path, ["b10.png", "b2.png", "a1.png", "b1.png", "._b1.png"])
    (tmp_path / "notes.txt").write_text("")
    assert [path.name for path in image_files(tmp_path)] == ["a1.png", "b1.png", "b2.png", "b10.png"]


def test_numbered_images(tmp_path, write_images):
    write_images(tmp_path, ["I1_000010.png", "I1_000009.png", "I2_000001.png", "preview.png"])
    assert list(numbered_images(tmp_path, "I1_")) == [9, 10]
    with pytest.raises(SequenceError, match=r"holds no images named 000000\.png"):
        numbered_images(tmp_path)


@pytest.mark.parametrize(("numbers", "text"), [([], ""), ([4], "4"), ([1, 2, 3, 7, 9, 10], "1-3, 7, 9-10")])
def test_ranges(numbers, text):
    assert ranges(numbers) == text


@pytest.mark.parametrize(
    "names",
    [
        ["1305031102.0", "1305031102.05", "1305031102.1", "1305031102.15", "1305031102.2"],
        ["f_9.5", "f_10", "f_10.25", "f_10.3"],
        ["shot1.8", "shot1.9", "shot1.10", "shot1.11"],
        ["1-2", "1-10", "2-1"],
    ],
)
def test_order_of_decimals_and_of_numbers(tmp_path, write_images, names):
    write_images(tmp_path, [f"{name}.png" for name in reversed(names)])
    assert [path.stem for path in image_files(tmp_path)] == names


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (["1305031102.0", "1305031102.05", "1305031102.1"], "seconds"),
        (["1305031102000", "1305031102050", "1305031102100"], "milliseconds"),
        (["cam_1305031102000000", "cam_1305031102050000", "cam_1305031102100000"], "microseconds"),
        (["1305031102000000000", "1305031102050000000", "1305031102100000000"], "nanoseconds"),
        (["000000", "000001", "000002"], None),
        (["1305031102000", "1305031102050", "9905031102100"], None),
        (["1305031102000", "1305031202050", "1305031302100"], None),  # every 100 seconds
        (["a1305031102000", "b1305031102050"], None),
    ],
)
def test_stamps_that_are_names(tmp_path, names, unit):
    told = stamps_in_names([tmp_path / f"{name}.png" for name in names])
    assert (told and told[1]) == unit
    if told:
        np.testing.assert_allclose(told[0] - told[0][0], [0, 0.05, 0.1], atol=1e-6)


def test_a_stamp_is_no_number_of_an_image(tmp_path, write_images):
    write_images(tmp_path, ["000000.png", "1403715273262142976.png"])
    with pytest.raises(SequenceError, match=r"images should be numbered .* 1403715273262142976\.png is no such number"):
        numbered_images(tmp_path)


def test_many_ranges_are_cut():
    assert ranges(range(0, 40, 2)) == "0, 2, 4, 6, 8, 10, 12, 14, 16, 18 and 10 more such"
