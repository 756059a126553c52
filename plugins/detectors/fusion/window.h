// Which places of a map may differ between two inputs: intervals of its rows, and rectangles that cover them.
#pragma once

#include <cstdint>
#include <vector>

#include "base/sizes.h"

namespace mirage::fusion {

/// Places [top, bottom) × [left, right) of a map.
struct Window {
  std::int64_t top = 0, left = 0, bottom = 0, right = 0;
  std::int64_t rows() const { return bottom > top ? bottom - top : 0; }
  std::int64_t columns() const { return right > left ? right - left : 0; }
  std::int64_t area() const { return rows() * columns(); }
  bool empty() const { return area() == 0; }
  bool operator==(const Window&) const = default;
};
Window intersection(const Window& a, const Window& b);
/// The smallest that holds both; an empty one counts for nothing.
Window bounds(const Window& a, const Window& b);
bool holds(const Window& outer, const Window& inner);
/// The same places in a map of half the size, including partial ones.
Window halved(const Window& at);
/// The same places in a map of twice the size.
Window doubled(const Window& at);

/// How a layer reads: output o needs the inputs o · stride − padding … o · stride − padding + kernel − 1.
struct Reach {
  std::int64_t kernel = 1, stride = 1, padding = 0;
};
/// Inputs that the outputs of `out` read; may go beyond the map.
Window read_by(const Window& out, const Reach& reach);
/// Outputs (of a map of rows × columns) that read an input of `in`.
Window reached_by(const Window& in, const Reach& reach, std::int64_t rows, std::int64_t columns);

/// One interval a row of a map; empty where low ≥ high.
class ChangedRegion {
 public:
  struct Span {
    std::int64_t low = 0, high = 0;
    bool empty() const { return low >= high; }
    void add(Span other);
  };
  ChangedRegion() = default;
  ChangedRegion(std::int64_t rows, std::int64_t columns) : rows_(as_size(rows)), columns_(columns) {}

  std::int64_t rows() const { return static_cast<std::int64_t>(rows_.size()); }
  std::int64_t columns() const { return columns_; }
  const Span& row(std::int64_t r) const { return rows_[as_size(r)]; }
  bool empty() const;
  std::int64_t area() const;
  void add(std::int64_t row, std::int64_t column) { add(Window{row, column, row + 1, column + 1}); }
  void add(const Window& window);         ///< clipped to the map
  void add(const ChangedRegion& other);   ///< of a map of the same size
  void keep(const ChangedRegion& other);  ///< intersects with the other, of a map of the same size
  /// The changed region of the output of a layer that reads this map.
  ChangedRegion through(const Reach& reach, std::int64_t rows, std::int64_t columns) const;
  /// The changed region of the map doubled along both axes, cut to `rows`.
  ChangedRegion doubled(std::int64_t rows) const;
  /// Disjoint windows that cover it: rows are merged while that adds fewer than `worth` places.
  std::vector<Window> windows(std::int64_t worth) const;

 private:
  std::vector<Span> rows_;
  std::int64_t columns_ = 0;
};

}  // namespace mirage::fusion
