#include "geometry/picture_box.h"

#include <algorithm>

namespace mirage {

double area(const PictureBox& box) {
  return std::max(0.0, box.right - box.left) * std::max(0.0, box.bottom - box.top);
}

double intersection_area(const PictureBox& a, const PictureBox& b) {
  return area({std::max(a.left, b.left), std::max(a.top, b.top), std::min(a.right, b.right),
               std::min(a.bottom, b.bottom)});
}

double iou(const PictureBox& a, const PictureBox& b) {
  const double both = intersection_area(a, b);
  return both > 0 ? std::clamp(both / (area(a) + area(b) - both), 0.0, 1.0) : 0;
}

BevBox rectangle(const PictureBox& box) {
  return {(box.left + box.right) / 2, (box.top + box.bottom) / 2, box.right - box.left, box.bottom - box.top,
          0};
}

PictureBox picture_box(const BevBox& rectangle) {
  const auto& [x, y, length, width, yaw] = rectangle;
  return {x - length / 2, y - width / 2, x + length / 2, y + width / 2};
}

PictureBox joined(const PictureBox& a, const PictureBox& b) {
  return {std::min(a.left, b.left), std::min(a.top, b.top), std::max(a.right, b.right),
          std::max(a.bottom, b.bottom)};
}

PictureBox within(const PictureBox& box, int width, int height) {
  const double last_column = std::max(0, width - 1), last_row = std::max(0, height - 1);
  return {std::clamp(box.left, 0.0, last_column), std::clamp(box.top, 0.0, last_row),
          std::clamp(box.right, 0.0, last_column), std::clamp(box.bottom, 0.0, last_row)};
}

}  // namespace mirage
