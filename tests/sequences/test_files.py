import pytest

from fvslam_graph.errors import SequenceError
from fvslam_graph.sequences.files import image_files, numbered_images, ranges


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
