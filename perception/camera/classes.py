"""The 80 COCO classes in network order, and their obstacle classes."""

import numpy as np

from geometry.arrays import Float32, Float64
from messages.perception import ObstacleClass
from perception.class_order import CLASSES

COCO = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow", "elephant",
    "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard",
    "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange", "broccoli",
    "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed", "dining table", "toilet",
    "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven", "toaster", "sink",
    "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)  # fmt: skip

# Birds fly off and are no obstacle; aeroplanes and boats do not occur in fields.
MEMBERS: dict[ObstacleClass, tuple[str, ...]] = {
    ObstacleClass.PERSON: ("person",),
    ObstacleClass.ANIMAL: ("cat", "dog", "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe"),
    ObstacleClass.VEHICLE: ("bicycle", "car", "motorcycle", "bus", "train", "truck"),
}
GROUPS = tuple(MEMBERS)
_COLUMNS = tuple(np.array([COCO.index(name) for name in MEMBERS[group]]) for group in GROUPS)


def group_scores(scores: Float32) -> Float32:
    """Scores (N, 3) of `GROUPS` from those of the COCO classes (N, 80): the best of each group's members."""
    return np.stack([scores[:, columns].max(axis=1) for columns in _COLUMNS], axis=1)


def class_scores(group: int, score: float) -> Float64:
    """Class scores (8,) in the order of `ObstacleClass`: the remainder is shared equally by the other classes."""
    row = np.full(len(CLASSES), (1.0 - score) / (len(CLASSES) - 1))
    row[CLASSES.index(GROUPS[group])] = score
    return row
