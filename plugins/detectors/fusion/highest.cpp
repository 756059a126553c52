#include "highest.h"

#include <algorithm>

namespace mirage::fusion {

std::vector<std::int64_t> highest(const torch::Tensor& logits, float least, std::size_t most) {
  const torch::Tensor plain = logits.detach().to(torch::kFloat).contiguous();
  const float* value = plain.data_ptr<float>();
  std::vector<std::int64_t> places;
  for (std::int64_t k = 0; k < plain.numel(); ++k)
    if (value[k] > least) places.push_back(k);
  if (places.size() > most) {
    std::nth_element(places.begin(), places.begin() + static_cast<std::ptrdiff_t>(most), places.end(),
                     [&](std::int64_t a, std::int64_t b) {
                       return value[a] > value[b] || (value[a] == value[b] && a < b);
                     });
    places.resize(most);
    std::sort(places.begin(), places.end());
  }
  return places;
}

}  // namespace mirage::fusion
