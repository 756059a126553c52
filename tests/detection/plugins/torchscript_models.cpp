// Writes TorchScript models for the tests, one that works and others that are wrong in one way:
//     torchscript_models DIR
#include <torch/script.h>

#include <string>
#include <utility>

namespace {

const char* const kBoxes = R"(
        boxes = torch.tensor([[10., 0., 4., 2., 0.], [12., 2., 4., 2., 0.3], [20., -3., 4., 2., 1.]])
)";

/// Three fixed boxes; a logit sums picture and reflectance at the points, weighted by their distance.
const char* const kWorks = R"(
    def forward(self, image, points, pixel_from_velo):
        ones = torch.ones([points.size(0), 1])
        uvw = torch.matmul(torch.cat([points[:, :3], ones], 1), torch.t(pixel_from_velo))
        uv = uvw[:, :2] / uvw[:, 2:].clamp(0.1)
        size = torch.tensor([float(image.size(1)), float(image.size(0))])
        grid = ((2 * uv + 1) / size - 1).view([1, 1, -1, 2])
        picture = image.permute([2, 0, 1]).unsqueeze(0)
        seen = torch.grid_sampler(picture, grid, 0, 1, False)[0, :, 0].sum(0)
        boxes = torch.tensor([[10., 0., 4., 2., 0.], [12., 2., 4., 2., 0.3], [20., -3., 4., 2., 1.]])
        apart = (points[:, :2].unsqueeze(0) - boxes[:, :2].unsqueeze(1)).pow(2).sum(2)
        near = torch.exp(-apart / 8)
        logits = (near * (seen + points[:, 3]).unsqueeze(0) * torch.cos(points[:, 2])).sum(1)
        return boxes, logits
    def region(self):
        return (0.0, 50.0, -20.0, 20.0)
)";

/// Two fixed boxes in the picture; a logit depends on the red and green values inside.
const char* const kPicture = R"(
    def forward(self, image):
        boxes = torch.tensor([[2., 3., 20., 12.], [30., 5., 50., 25.]])
        first = image[3:12, 2:20, 0].pow(2).mean()
        second = image[5:25, 30:50, 1].pow(2).mean() - image[5:25, 30:50, 0].mean()
        return boxes, torch.stack([first, second])
)";

std::string in_picture(const std::string& arguments, const std::string& result) {
  return "\n    def forward(self, image" + arguments +
         "):\n        boxes = torch.tensor([[2., 3., 20., 12.], [30., 5., 50., 25.]])\n"
         "        logits = image[0, :2, 0]\n        return " +
         result + "\n";
}

std::string returning(const std::string& result) {
  return "\n    def forward(self, image, points, pixel_from_velo):" + std::string(kBoxes) +
         "        logits = image.sum() + points[:3, 0]\n        return " + result + "\n";
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 2) return 2;
  const std::string folder = std::string(arguments[1]) + "/";
  const std::pair<const char*, std::string> models[] = {
      {"works", kWorks},
      {"picture", kPicture},
      {"picture_option", in_picture(", scale: float = 2.0", "boxes, logits * scale")},
      {"picture_options",
       in_picture(", scale: float = 2.0, shift: float = 1.0", "boxes, logits * scale + shift")},
      {"picture_columns", in_picture("", "torch.zeros([2, 5]), logits")},
      {"picture_one_tensor", in_picture("", "logits")},
      {"picture_detached", in_picture("", "boxes, logits.detach()")},
      {"picture_typed", "\n    def forward(self, image: float):\n        return image, image\n"},
      {"no_argument", "\n    def forward(self):\n        return 1, 2\n"},
      {"empty", returning("boxes[:0], logits[:0]")},
      {"two_arguments", "\n    def forward(self, image, points):\n        return points, points\n"},
      {"typed",
       "\n    def forward(self, image, points: List[float], pixel_from_velo):\n"
       "        return image, image\n"},
      {"one_tensor", returning("boxes")},
      {"box_columns", returning("boxes[:, :4], logits")},
      {"logit_count", returning("boxes, logits[:2]")},
      {"whole_numbers", returning("boxes, logits.to(4)")},
      {"not_finite", returning("boxes, torch.log(logits * 0 - 1)")},
      {"infinite_gradient", returning("boxes, torch.sqrt(logits * 0)")},
      {"negative_length", returning("boxes * torch.tensor([1., 1., -1., 1., 1.]), logits")},
      {"negative_sides", returning("boxes * torch.tensor([1., 1., -1., -1., 1.]), logits")},
      {"no_width", returning("boxes * torch.tensor([1., 1., 1., 0., 1.]), logits")},
      {"huge", returning("boxes * torch.tensor([1., 1., 1000., 1., 1.]), logits")},
      {"far", returning("boxes * torch.tensor([1e6, 1., 1., 1., 1.]), logits")},
      {"picture_centres", in_picture("", "torch.tensor([[20., 9., 6., 4.], [40., 9., 6., 4.]]), logits")},
      {"detached", returning("boxes, logits.detach()")},
      {"fails_inside", returning("boxes, torch.mm(points, points).sum(1)")},
      {"bad_region", returning("boxes, logits") + "    def region(self):\n        return (50.0, 0.0, 1.0)\n"},
  };
  for (const auto& [name, source] : models) {
    torch::jit::Module module(name);
    module.define(source);
    module.save(folder + name + ".pt");
  }
  // Writes a file when it is loaded, before any method is called.
  torch::jit::Module planted("planted");
  planted.define(
      "\n    def __getstate__(self):\n        return 1, True\n"
      "    def __setstate__(self, state: Tuple[int, bool]):\n"
      "        torch.save(state, \"" +
      folder + "mark\")\n");
  planted.save(folder + "planted.pt");
  torch::jit::Module nothing("no_forward");
  nothing.define("\n    def predict(self, image):\n        return image\n");
  nothing.save(folder + "no_forward.pt");
  return 0;
}
