#include "window.h"

#include <algorithm>

namespace mirage::fusion {
namespace {

/// ⌈a / b⌉ and ⌊a / b⌋ for b > 0 and any a.
std::int64_t ceil_of(std::int64_t a, std::int64_t b) {
  return a > 0 ? (a + b - 1) / b : a / b;
}
std::int64_t floor_of(std::int64_t a, std::int64_t b) {
  return a >= 0 ? a / b : -((b - 1 - a) / b);
}

/// Outputs that read an input of [low, high), of `count` outputs.
ChangedRegion::Span readers(ChangedRegion::Span in, const Reach& reach, std::int64_t count) {
  if (in.empty()) return {};
  return {std::max<std::int64_t>(0, ceil_of(in.low + reach.padding - reach.kernel + 1, reach.stride)),
          std::min(count, floor_of(in.high - 1 + reach.padding, reach.stride) + 1)};
}

}  // namespace

Window intersection(const Window& a, const Window& b) {
  return {std::max(a.top, b.top), std::max(a.left, b.left), std::min(a.bottom, b.bottom),
          std::min(a.right, b.right)};
}

Window bounds(const Window& a, const Window& b) {
  if (a.empty()) return b;
  if (b.empty()) return a;
  return {std::min(a.top, b.top), std::min(a.left, b.left), std::max(a.bottom, b.bottom),
          std::max(a.right, b.right)};
}

bool holds(const Window& outer, const Window& inner) {
  return inner.empty() || intersection(outer, inner) == inner;
}

Window halved(const Window& at) {
  return {at.top / 2, at.left / 2, (at.bottom + 1) / 2, (at.right + 1) / 2};
}

Window doubled(const Window& at) {
  return {2 * at.top, 2 * at.left, 2 * at.bottom, 2 * at.right};
}

Window read_by(const Window& out, const Reach& reach) {
  const auto first = [&](std::int64_t o) { return o * reach.stride - reach.padding; };
  return {first(out.top), first(out.left), first(out.bottom - 1) + reach.kernel,
          first(out.right - 1) + reach.kernel};
}

Window reached_by(const Window& in, const Reach& reach, std::int64_t rows, std::int64_t columns) {
  const ChangedRegion::Span r = readers({in.top, in.bottom}, reach, rows),
                            c = readers({in.left, in.right}, reach, columns);
  return {r.low, c.low, r.high, c.high};
}

void ChangedRegion::Span::add(Span other) {
  if (other.empty()) return;
  if (empty())
    *this = other;
  else
    low = std::min(low, other.low), high = std::max(high, other.high);
}

bool ChangedRegion::empty() const {
  return std::all_of(rows_.begin(), rows_.end(), [](const Span& s) { return s.empty(); });
}

std::int64_t ChangedRegion::area() const {
  std::int64_t places = 0;
  for (const Span& s : rows_) places += s.empty() ? 0 : s.high - s.low;
  return places;
}

void ChangedRegion::add(const Window& window) {
  const Window inside = intersection(window, {0, 0, rows(), columns_});
  if (inside.empty()) return;
  for (std::int64_t r = inside.top; r < inside.bottom; ++r)
    rows_[as_size(r)].add({inside.left, inside.right});
}

void ChangedRegion::add(const ChangedRegion& other) {
  for (std::size_t r = 0; r < rows_.size(); ++r) rows_[r].add(other.rows_[r]);
}

void ChangedRegion::keep(const ChangedRegion& other) {
  for (std::size_t r = 0; r < rows_.size(); ++r) {
    const Span& by = other.rows_[r];
    rows_[r] = by.empty() ? Span{} : Span{std::max(rows_[r].low, by.low), std::min(rows_[r].high, by.high)};
  }
}

ChangedRegion ChangedRegion::through(const Reach& reach, std::int64_t out_rows,
                                     std::int64_t out_columns) const {
  ChangedRegion out(out_rows, out_columns);
  for (std::int64_t r = 0; r < rows(); ++r) {
    const Span columns = readers(row(r), reach, out_columns);
    if (columns.empty()) continue;
    const Span reading = readers({r, r + 1}, reach, out_rows);
    for (std::int64_t o = reading.low; o < reading.high; ++o) out.rows_[as_size(o)].add(columns);
  }
  return out;
}

ChangedRegion ChangedRegion::doubled(std::int64_t out_rows) const {
  ChangedRegion out(out_rows, 2 * columns_);
  for (std::int64_t r = 0; r < out_rows; ++r)
    out.rows_[as_size(r)] = {2 * row(r / 2).low, 2 * row(r / 2).high};
  return out;
}

std::vector<Window> ChangedRegion::windows(std::int64_t worth) const {
  std::vector<Window> merged;
  std::int64_t open_area = 0;  // of the last window's own spans
  for (std::int64_t r = 0; r < rows(); ++r) {
    const Span& span = row(r);
    if (span.empty()) continue;
    const Window line{r, span.low, r + 1, span.high};
    if (!merged.empty()) {
      const Window both = bounds(merged.back(), line);
      if (both.area() - open_area - line.area() < worth) {
        merged.back() = both;
        open_area += line.area();
        continue;
      }
    }
    merged.push_back(line);
    open_area = line.area();
  }
  return merged;
}

}  // namespace mirage::fusion
