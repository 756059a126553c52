"""Writes ONNX models for the tests, some that work and others that are wrong in one way: onnx_models.py DIR"""

import sys

import onnx
from onnx import TensorProto, helper

FLOAT, DOUBLE = TensorProto.FLOAT, TensorProto.DOUBLE
IMAGE, POINTS, MATRIX = ("image", ["H", "W", 3]), ("points", ["N", 4]), ("pixel_from_velo", [3, 4])
BOXES = ("boxes", FLOAT, [3, 5], [10, 0, 4, 2, 0, 12, 2, 4, 2, 0.3, 20, -3, 4, 2, 1])
IN_PICTURE = ("boxes", FLOAT, [2, 4], [2, 3, 20, 12, 30, 5, 50, 25])
WEIGHTS = ("weights", FLOAT, [3], [1, -0.5, 2])


def constant(name, kind, shape, values):
    return helper.make_node("Constant", [], [name], value=helper.make_tensor(name, kind, shape, values))


def node(kind, inputs, output, **attributes):
    return helper.make_node(kind, inputs.split(), [output], **attributes)


def mean(name, to):
    return node("ReduceMean", name, to, keepdims=0)


# logits = (mean of the picture + mean of the points + the projection's last number) * weights
LOGITS = [constant(*WEIGHTS), mean("image", "of_image"), mean("points", "of_points"), constant("last", TensorProto.INT64, [], [11]),
          constant("flat", TensorProto.INT64, [1], [-1]), node("Reshape", "pixel_from_velo flat", "numbers"),
          node("Gather", "numbers last", "shift"), node("Add", "of_image of_points", "both"), node("Add", "both shift", "sum"),
          node("Mul", "sum weights", "logits")]
PICTURE_LOGITS = [constant("weights", FLOAT, [2], [1, -0.5]), mean("image", "of_image"), node("Mul", "of_image weights", "logits")]


def write(folder, name, nodes, inputs=(IMAGE, POINTS, MATRIX), outputs=(("boxes", FLOAT, 2), ("logits", FLOAT, 1)), region=None,
          kind=FLOAT):
    graph = helper.make_graph(
        nodes, name, [helper.make_tensor_value_info(place, kind, shape) for place, shape in inputs],
        [helper.make_tensor_value_info(place, its, [None] * axes) for place, its, axes in outputs])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if region is not None:
        helper.set_model_props(model, {"region": region})
    onnx.save(model, f"{folder}/{name}.onnx")


def main(folder):
    boxes = constant(*BOXES)
    write(folder, "works", [boxes, *LOGITS], region="0 50 -20 20")
    write(folder, "picture", [constant(*IN_PICTURE), *PICTURE_LOGITS], [IMAGE])
    write(folder, "sweep", [boxes, constant(*WEIGHTS), mean("points", "of_points"), node("Mul", "of_points weights", "logits")], [POINTS])
    write(folder, "of_a_size", [constant(*IN_PICTURE), *PICTURE_LOGITS], [("image", [8, 16, 3])])
    write(folder, "channels_first", [constant(*IN_PICTURE), *PICTURE_LOGITS], [("image", [1, 3, "H", "W"])])
    write(folder, "other_input", [constant(*IN_PICTURE), node("ReduceMean", "data", "m", keepdims=0), constant("weights", FLOAT, [2], [1, 1]),
                                  node("Mul", "m weights", "logits")], [("data", ["H", "W", 3])])
    write(folder, "double", [boxes, constant("logits", FLOAT, [3], [0, 0, 0])], [POINTS], kind=DOUBLE)
    write(folder, "no_boxes", [constant("logits", FLOAT, [3], [0, 0, 0])], [POINTS], [("logits", FLOAT, 1)])
    write(folder, "columns", [constant("boxes", FLOAT, [1, 7], range(7)), constant("logits", FLOAT, [1], [0])], [POINTS])
    write(folder, "count", [boxes, constant("logits", FLOAT, [2], [0, 0])], [POINTS])
    write(folder, "whole_numbers", [boxes, constant("logits", TensorProto.INT64, [3], [0, 0, 0])], [POINTS],
          [("boxes", FLOAT, 2), ("logits", TensorProto.INT64, 1)])
    write(folder, "not_finite", [boxes, constant("nought", FLOAT, [3], [0, 0, 0]), node("Log", "nought", "logits")], [POINTS])
    write(folder, "bad_region", [boxes, *LOGITS], region="0 50 20")


if __name__ == "__main__":
    main(sys.argv[1])
