#include "attack/validation_part.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>

#include "base/fields.h"
#include "base/random.h"
#include "base/shuffle.h"

namespace mirage {

ValidationPart split_validation(const std::vector<Host>& train, std::uint64_t seed, std::size_t at_most,
                                const char* field) {
  std::map<std::string, std::size_t> hosts;  // of each frame
  for (const Host& host : train) ++hosts[host.id.frame];
  std::vector<std::string> frames;
  for (const auto& [frame, count] : hosts) frames.push_back(frame);
  if (frames.size() < 2)
    throw FieldError(field, std::to_string(frames.size()) + " training frame",
                     "has no second one to hold out", "give more frames, or leave the option out");
  RandomStream random(seed, "validation part");
  shuffle(frames, random);
  const auto most = std::clamp<std::size_t>(
      static_cast<std::size_t>(std::lround(kHeldOutShare * static_cast<double>(frames.size()))), 1,
      frames.size() - 1);
  std::set<std::string> held;
  std::size_t vehicles = 0;
  for (std::size_t i = 0; i < most && vehicles < at_most; ++i) {
    held.insert(frames[i]);
    vehicles += hosts[frames[i]];
  }
  ValidationPart part;
  for (const Host& host : train) (held.contains(host.id.frame) ? part.held_out : part.learn).push_back(host);
  return part;
}

}  // namespace mirage
