// Which vehicle carries the adversary.
#pragma once

#include <string>

namespace mirage {

/// One host vehicle: a label of a frame.
struct HostId {
  std::string frame;
  int label = 0;  ///< index into Frame::labels
};

}  // namespace mirage
