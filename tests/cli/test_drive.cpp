// `mirage drive` and `mirage audit --gate` with the user's own program: stored answers and messages.
#include <array>
#include <cstdint>

#include "program.h"

namespace mirage {
namespace {

using testing::HasSubstr;
using testing::Not;

/// Finds every car and van of the drive, or none, as net.txt says; the file's second word is the version.
constexpr const char* kNetwork = R"(
import pathlib
import mirage_serve
import numpy as np

HERE = pathlib.Path(__file__).parent
SEES, *VERSION = (HERE / "net.txt").read_text().split()
ROWS = [row.split() for row in (HERE / "data/training/label_02/0000.txt").read_text().splitlines()]

def detector(frame):
    cars = [[float(row[15]) + 0.27, -float(row[13]), 4, 1.8, -float(row[16]) - np.pi / 2] for row in ROWS
            if SEES == "sees" and int(row[0]) == frame.moment["index"] and row[2] in ("Car", "Van")]
    return np.array(cars, np.float32).reshape(-1, 5), np.full(len(cars), 3.0, np.float32)

detector.reads = ("points",)
detector.version = VERSION[0] if VERSION else ""
mirage_serve.serve(detector)
)";

class Drive : public test::Program {
 protected:
  void SetUp() override {
    environment_ = "MIRAGE_CACHE=" + at("cache");
    write_file(folder_ / "network.py", kNetwork);
  }
  /// A pyramid whose geometry lies beside the .gltf; `ahead` moves a corner inside the same box.
  void write_pyramid(float ahead) const {
    const std::array<float, 12> corners = {-0.5f, 0, -0.5f, 0.5f, 0, -0.5f, ahead, 0, 0.5f, 0, 0.6f, 0};
    const std::array<std::uint16_t, 12> faces = {0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0};
    write_file(folder_ / "pyramid.bin", std::string(reinterpret_cast<const char*>(corners.data()), 48) +
                                            std::string(reinterpret_cast<const char*>(faces.data()), 24));
    write_file(folder_ / "pyramid.gltf",
               R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
      "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
      "buffers": [{"byteLength": 72, "uri": "pyramid.bin"}],
      "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
      "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-0.5, 0, -0.5],
        "max": [0.5, 0.6, 0.5]}, {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}]})");
  }
  /// result.json of the drive with that network.
  nlohmann::json driven(const std::string& network, const std::string& more = "") const {
    write_file(folder_ / "net.txt", network);
    EXPECT_EQ(mirage("drive --quiet --rooftop box --least-frames 3 --data " + at("data") + " --mesh " +
                     at("pyramid.gltf") + " --detector \"exec:/usr/bin/python3 -B " + at("network.py") +
                     "\" --out " + at("drive") + more),
              0)
        << said();
    return json("drive/result.json");
  }
  static double gap(const nlohmann::json& result) {
    return result.at("drive").at("gap_s").at("clean").at("value");
  }
};

TEST_F(Drive, WhatAnotherNetworkOrAnotherObjectShowedIsNotTaken) {
  ASSERT_EQ(mirage("generate --quiet --rig kitti64 --drives 1 --seconds 0.3 --seed 3 --out " + at("data")), 0)
      << said();
  write_pyramid(0);
  EXPECT_EQ(gap(driven("sees")), 0);
  EXPECT_GT(gap(driven("blind")), 0.2);  // without a version, no answer is read from the cache
  EXPECT_EQ(gap(driven("sees 1")), 0);
  const nlohmann::json second = driven("blind 2");
  EXPECT_GT(gap(second), 0.2);
  EXPECT_THAT(text("drive/drive.html"), testing::AllOf(HasSubstr("all phantoms, as recorded"),
                                                       HasSubstr("new phantoms, with the object")));
  const auto of = [](const nlohmann::json& result, const char* what) {
    return result.at("provenance").at("inputs").at(what);
  };
  write_pyramid(0.2f);
  const nlohmann::json other = driven("blind 2");
  for (const char* what : {"mesh", "object"}) EXPECT_NE(of(other, what), of(second, what)) << what;
  EXPECT_NE(other.at("provenance").at("identity"), second.at("provenance").at("identity"));

  const auto types = [](const nlohmann::json& result) { return result.at("drive").at("vehicles").dump(); };
  EXPECT_THAT(types(other), HasSubstr("\"Van\""));
  EXPECT_THAT(types(driven("blind 2", " --classes Car")), Not(HasSubstr("\"Van\"")));
}

TEST_F(Drive, TheGateOfADetectorWithoutACameraTellsNoPrecision) {
  ASSERT_TRUE(std::filesystem::exists(frames_)) << "ctest makes them (frames.generated)";
  write_file(folder_ / "blind.py",
             "import mirage_serve\nimport numpy as np\n"
             "mirage_serve.serve(lambda points: (np.zeros((0, 5), np.float32), np.zeros(0, np.float32)))\n");
  ASSERT_EQ(mirage("audit --gate --data " + frames_ + " --detector \"exec:/usr/bin/python3 -B " +
                   at("blind.py") + "\" --out " + at("audit")),
            0)
      << said();
  EXPECT_THAT(said(), testing::AllOf(HasSubstr("has no picture"), Not(HasSubstr("AP 0.7"))));
  const nlohmann::json result = json("audit/result.json");
  EXPECT_EQ(result.at("reliance").at("reads_picture"), false);
  for (const char* measured : {"ap70", "vehicles", "frames"}) EXPECT_FALSE(result.contains(measured));
}

}  // namespace
}  // namespace mirage
