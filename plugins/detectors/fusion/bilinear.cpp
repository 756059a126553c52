#include "bilinear.h"

#include <ATen/Dispatch.h>

#include <algorithm>
#include <array>

namespace mirage::fusion {
namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

/// The two cells along one axis and the share of the upper one.
template <class T>
struct Pair {
  std::int64_t low, high;
  T share;
  bool inside;  // the result moves with the place
};

template <class T>
Pair<T> pair_at(T at, std::int64_t size) {
  const auto last = static_cast<T>(size - 1);
  // Written so that NaN lands on 0.
  const T clamped = at > 0 ? std::min(at, last) : T(0);
  const auto low = static_cast<std::int64_t>(clamped);
  return {low, std::min(low + 1, size - 1), clamped - static_cast<T>(low), at > 0 && at < last};
}

/// The four cells around a place, as offsets into the map, and their weights.
template <class T>
struct Around {
  Around(const T* place, const Tensor& cells)
      : x(pair_at(place[0], cells.size(1))), y(pair_at(place[1], cells.size(0))) {
    const std::int64_t width = cells.size(1), channels = cells.size(2);
    at = {(y.low * width + x.low) * channels, (y.low * width + x.high) * channels,
          (y.high * width + x.low) * channels, (y.high * width + x.high) * channels};
    weight = {(1 - y.share) * (1 - x.share), (1 - y.share) * x.share, y.share * (1 - x.share),
              y.share * x.share};
  }
  Pair<T> x, y;
  std::array<std::int64_t, 4> at;
  std::array<T, 4> weight;
};

template <class T>
void read_places(const Tensor& cells, const Tensor& places, Tensor& read) {
  const std::int64_t channels = cells.size(2);
  const T* f = cells.data_ptr<T>();
  T* out = read.data_ptr<T>();
  for (std::int64_t i = 0; i < places.size(0); ++i, out += channels) {
    const auto [x, y, at, weight] = Around<T>(places.data_ptr<T>() + 2 * i, cells);
    for (std::int64_t c = 0; c < channels; ++c)
      out[c] = weight[0] * f[at[0] + c] + weight[1] * f[at[1] + c] + weight[2] * f[at[2] + c] +
               weight[3] * f[at[3] + c];
  }
}

template <class T>
void read_places_vjp(const Tensor& cells, const Tensor& places, const Tensor& d_read, Tensor& d_cells,
                     Tensor& d_places) {
  const std::int64_t channels = cells.size(2);
  const T* f = cells.data_ptr<T>();
  const T* d = d_read.data_ptr<T>();
  T* df = d_cells.data_ptr<T>();
  for (std::int64_t i = 0; i < places.size(0); ++i, d += channels) {
    const auto [x, y, at, weight] = Around<T>(places.data_ptr<T>() + 2 * i, cells);
    T along_x = 0, along_y = 0;
    for (std::int64_t c = 0; c < channels; ++c) {
      for (int k = 0; k < 4; ++k) df[at[k] + c] += weight[k] * d[c];
      const T f00 = f[at[0] + c], f01 = f[at[1] + c], f10 = f[at[2] + c], f11 = f[at[3] + c];
      along_x += d[c] * ((1 - y.share) * (f01 - f00) + y.share * (f11 - f10));
      along_y += d[c] * ((1 - x.share) * (f10 - f00) + x.share * (f11 - f01));
    }
    T* dp = d_places.data_ptr<T>() + 2 * i;
    if (x.inside) dp[0] = along_x;
    if (y.inside) dp[1] = along_y;
  }
}

struct Bilinear : torch::autograd::Function<Bilinear> {
  static Tensor forward(AutogradContext* context, const Tensor& map, const Tensor& at) {
    // H × W × C in memory
    const Tensor cells = map.squeeze(0).permute({1, 2, 0}).contiguous(), places = at.contiguous();
    context->save_for_backward({cells, places});
    Tensor read = torch::empty({places.size(0), cells.size(2)}, cells.options());
    AT_DISPATCH_FLOATING_TYPES(cells.scalar_type(), "bilinear",
                               [&] { read_places<scalar_t>(cells, places, read); });
    return read;
  }

  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const variable_list saved = context->get_saved_variables();
    Tensor d_cells = torch::zeros_like(saved[0]), d_places = torch::zeros_like(saved[1]);
    AT_DISPATCH_FLOATING_TYPES(saved[0].scalar_type(), "bilinear", [&] {
      read_places_vjp<scalar_t>(saved[0], saved[1], gradients[0].contiguous(), d_cells, d_places);
    });
    return {d_cells.permute({2, 0, 1}).unsqueeze(0), d_places};
  }
};

}  // namespace

Tensor bilinear(const Tensor& map, const Tensor& at) {
  return Bilinear::apply(map, at);
}

Tensor places_in_map(const Tensor& pixels, int stride) {
  // Pixel centres are whole numbers, and so are those of the map's places: both edges lie at −1/2.
  return (pixels + 0.5) / stride - 0.5;
}

}  // namespace mirage::fusion
