// Items by their group.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace mirage {

/// Brings the items of each group together, in the order in which they were. Returns where each group's
/// start, and past the last. group_of(item): in [0, groups).
template <class Item, class GroupOf>
std::vector<int> group_together(std::vector<Item>& items, std::size_t groups, const GroupOf& group_of) {
  std::vector<int> first(groups + 1, 0);
  for (const Item& item : items) ++first[static_cast<std::size_t>(group_of(item)) + 1];
  for (std::size_t i = 1; i < first.size(); ++i) first[i] += first[i - 1];
  std::vector<Item> grouped(items.size());
  std::vector<int> next(first.begin(), first.end() - 1);
  for (const Item& item : items)
    grouped[static_cast<std::size_t>(next[static_cast<std::size_t>(group_of(item))]++)] = item;
  items = std::move(grouped);
  return first;
}

}  // namespace mirage
