// Putting a list in random order, the same by every machine and library.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "base/random.h"

namespace mirage {

/// Fisher and Yates's shuffle (Durstenfeld, CACM 1964) from the last place down. std::shuffle leaves to each
/// library what it draws.
template <class T>
void shuffle(std::vector<T>& list, RandomStream& random) {
  for (std::size_t i = list.size(); i > 1; --i)
    std::swap(list[i - 1], list[static_cast<std::size_t>(random.below(static_cast<int>(i)))]);
}

}  // namespace mirage
