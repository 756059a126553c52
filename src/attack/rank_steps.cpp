#include "attack/rank_steps.h"

#include "base/ranks.h"

namespace mirage {

std::vector<std::size_t> own_hosts(std::size_t n) {
  std::vector<std::size_t> own;
  for (auto k = static_cast<std::size_t>(rank()); k < n; k += static_cast<std::size_t>(rank_count()))
    own.push_back(k);
  return own;
}

void share_steps(std::vector<HostStep>& steps, const TexturedMesh& adversary) {
  if (rank_count() == 1) return;
  constexpr std::size_t kHead = 4;  // hide, false positives, hidden, found
  const std::size_t vertices = adversary.mesh.vertices.size(), texels = adversary.atlas.texels.size();
  std::vector<std::vector<double>> blocks(steps.size(), std::vector<double>(kHead + 3 * (vertices + texels)));
  const auto pack = [](std::vector<Vec3d>& points, double* into, bool out) {
    for (std::size_t i = 0; i < points.size(); ++i)
      for (int c = 0; c < 3; ++c)
        if (out)
          into[3 * i + static_cast<std::size_t>(c)] = points[i][c];
        else
          points[i][c] = into[3 * i + static_cast<std::size_t>(c)];
  };
  const auto move = [&](bool out) {
    for (std::size_t k = 0; k < steps.size(); ++k) {
      HostStep& step = steps[k];
      double* block = blocks[k].data();
      step.gradient.vertices.resize(vertices, Vec3d::Zero());
      step.gradient.texels.resize(texels, Vec3d::Zero());
      if (out)
        block[0] = step.hide, block[1] = step.false_positive, block[2] = step.hidden, block[3] = step.found;
      else
        step.hide = block[0], step.false_positive = block[1], step.hidden = block[2] != 0,
        step.found = block[3] != 0;
      pack(step.gradient.vertices, block + kHead, out);
      pack(step.gradient.texels, block + kHead + 3 * vertices, out);
    }
  };
  move(true);
  share_blocks(blocks);
  move(false);
}

}  // namespace mirage
