#include "attack/buildable.h"

#include <fmt/format.h>
#include <lcms2.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/names.h"
#include "base/sizes.h"
#include "geometry/solid.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char *kGamutField = "gamut", *kBox = "box:", *kChartFile = ".ti3";
constexpr std::uintmax_t kMaxPrintFileBytes = std::uintmax_t{1} << 24;
constexpr int kMaxPatches = 5'000, kMaxColumns = 1'000;
constexpr std::size_t kMaxCorners = 20'000;  // limit in a run.json, whose values are all bounded
/// Tolerance of the gamut test, for rounding.
constexpr double kInGamut = 1e-9;
constexpr const char* kCharts = "give an ICC profile of a CMYK printer, or a chart of patches (CGATS text)";

[[noreturn]] void fail(const fs::path& file, const std::string& field, const std::string& problem,
                       const std::string& fix) {
  throw InputError(file.string(), field, problem, fix);
}

/// Linear RGB of Rec. 709 primaries and D65 from XYZ relative to D50, by Bradford's adaptation (ICC.1:2010,
/// annex E). White maps to 1, 1, 1.
Eigen::Matrix3d rgb_from_d50() {
  const auto xyz = [](double x, double y) { return Vec3d(x / y, 1, (1 - x - y) / y); };
  const Vec3d d65 = xyz(0.3127, 0.3290), d50(0.9642, 1, 0.8249);
  Eigen::Matrix3d primaries;
  primaries << xyz(0.64, 0.33), xyz(0.30, 0.60), xyz(0.15, 0.06);
  const Eigen::Matrix3d xyz_from_rgb = primaries * (primaries.inverse() * d65).asDiagonal().toDenseMatrix();
  Eigen::Matrix3d cone;
  cone << 0.8951, 0.2664, -0.1614, -0.7502, 1.7135, 0.0367, 0.0389, -0.0685, 1.0296;
  const Eigen::Matrix3d d65_from_d50 =
      cone.inverse() * (cone * d65).cwiseQuotient(cone * d50).asDiagonal().toDenseMatrix() * cone;
  return xyz_from_rgb.inverse() * d65_from_d50;
}

/// A context of Little CMS that keeps the first error message.
class ColorEngine {
 public:
  ColorEngine() : context_(cmsCreateContext(nullptr, this)) {
    cmsSetLogErrorHandlerTHR(context_, [](cmsContext of, cmsUInt32Number, const char* text) {
      auto* engine = static_cast<ColorEngine*>(cmsGetContextUserData(of));
      if (engine && engine->reported.empty()) engine->reported = printable(text);
    });
  }
  ~ColorEngine() { cmsDeleteContext(context_); }
  ColorEngine(const ColorEngine&) = delete;
  ColorEngine& operator=(const ColorEngine&) = delete;
  cmsContext get() const { return context_; }
  /// The error message, or `otherwise` if there is none.
  std::string problem(const char* otherwise) const { return reported.empty() ? otherwise : reported; }
  std::string reported;

 private:
  cmsContext context_;
};

/// Closes a handle of Little CMS.
template <auto Close>
struct Closer {
  void operator()(void* handle) const { Close(handle); }
};
using Profile = std::unique_ptr<void, Closer<cmsCloseProfile>>;
using InkTransform = std::unique_ptr<void, Closer<cmsDeleteTransform>>;
using Chart = std::unique_ptr<void, Closer<cmsIT8Free>>;

/// XYZ (D50, perfect white 1) of the 16 overprints.
std::vector<Vec3d> patches_of_profile(const std::string& bytes, const fs::path& file) {
  const ColorEngine engine;
  const Profile profile(
      cmsOpenProfileFromMemTHR(engine.get(), bytes.data(), static_cast<cmsUInt32Number>(bytes.size())));
  if (!profile) fail(file, "header", engine.problem("is not an ICC profile"), kCharts);
  if (cmsGetColorSpace(profile.get()) != cmsSigCmykData ||
      cmsGetDeviceClass(profile.get()) != cmsSigOutputClass)
    fail(file, "colour space", "is not the profile of a CMYK printer", kCharts);
  const Profile measured(cmsCreateXYZProfileTHR(engine.get()));
  const InkTransform transform(
      cmsCreateTransformTHR(engine.get(), profile.get(), TYPE_CMYK_DBL, measured.get(), TYPE_XYZ_DBL,
                            INTENT_ABSOLUTE_COLORIMETRIC, cmsFLAGS_NOCACHE | cmsFLAGS_NOOPTIMIZE));
  if (!transform) fail(file, "A2B1", engine.problem("tells no colours of inks"), kCharts);
  std::vector<Vec3d> patches;
  for (int inks = 0; inks < 16; ++inks) {
    std::array<double, 4> cmyk;
    for (int k = 0; k < 4; ++k) cmyk[as_size(k)] = inks >> k & 1 ? 100 : 0;
    cmsCIEXYZ xyz{};
    cmsDoTransform(transform.get(), cmyk.data(), &xyz, 1);
    patches.emplace_back(xyz.X, xyz.Y, xyz.Z);
  }
  return patches;
}

/// nullopt if the text is no number.
std::optional<double> number_in(const std::string& text) {
  try {
    return parse_number(text, kGamutField);
  } catch (const FieldError&) {
    return std::nullopt;
  }
}

/// Whether the text would make Little CMS open another file.
bool includes(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](char c) { return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c; });
  return text.find(".INCLUDE") != std::string::npos || text.find("$INCLUDE") != std::string::npos;
}

/// XYZ (D50, perfect white 1) of a chart's patches.
std::vector<Vec3d> patches_of_chart(const std::string& text, const fs::path& file) {
  if (text.find('\0') != std::string::npos || text.empty()) fail(file, "", "is not text", kCharts);
  if (includes(text)) fail(file, "INCLUDE", "names another file, which is not read", "copy its patches here");
  const ColorEngine engine;
  const Chart chart(cmsIT8LoadFromMem(engine.get(), text.data(), static_cast<cmsUInt32Number>(text.size())));
  if (!chart) fail(file, "", engine.problem("is not CGATS text"), kCharts);
  char** names = nullptr;
  const int columns = cmsIT8EnumDataFormat(chart.get(), &names);
  const double reported = cmsIT8GetPropertyDbl(chart.get(), "NUMBER_OF_SETS");
  if (columns < 1 || columns > kMaxColumns || !names)
    fail(file, "BEGIN_DATA_FORMAT", "has no columns", "name them, as XYZ_X XYZ_Y XYZ_Z");
  if (!(reported >= 4 && reported <= kMaxPatches))
    fail(file, "NUMBER_OF_SETS", "is not a number of patches",
         fmt::format("measure 4 to {}, as 24 of a chart", kMaxPatches));
  const auto column = [&](const char* name) {
    for (int i = 0; i < columns; ++i)
      if (names[i] && std::string(name) == names[i]) return i;
    return -1;
  };
  const auto all = [&](const std::array<const char*, 3>& headings) -> std::optional<std::array<int, 3>> {
    const std::array<int, 3> found = {column(headings[0]), column(headings[1]), column(headings[2])};
    return std::ranges::min(found) < 0 ? std::nullopt : std::optional(found);
  };
  constexpr std::array<const char*, 3> kXyz = {"XYZ_X", "XYZ_Y", "XYZ_Z"}, kLab = {"LAB_L", "LAB_A", "LAB_B"};
  const auto xyz = all(kXyz), lab = xyz ? std::nullopt : all(kLab);
  if (!xyz && !lab)
    fail(file, "BEGIN_DATA_FORMAT", "has neither XYZ_X, XYZ_Y, XYZ_Z nor LAB_L, LAB_A, LAB_B",
         "give measured colours (D50, 2°)");
  const auto& from = xyz ? *xyz : *lab;
  const auto& called = xyz ? kXyz : kLab;
  std::vector<Vec3d> patches;
  for (int row = 0; row < static_cast<int>(reported); ++row) {
    Vec3d value;
    for (std::size_t k = 0; k < 3; ++k) {
      const char* cell = cmsIT8GetDataRowCol(chart.get(), row, from[k]);
      const std::string where = fmt::format("{} of patch {}", called[k], row + 1);
      const std::optional<double> number = cell ? number_in(cell) : std::nullopt;
      // Black backings and noise give values slightly below 0; optical brighteners exceed a perfect white.
      const Range range = xyz ? Range{-1, 150} : k == 0 ? Range{-1, 120} : Range{-200, 200};
      if (!number || !range.contains(*number))
        fail(file, where,
             cell ? printable(std::string(cell).substr(0, 40)) + " is not a measured colour" : "is missing",
             "use " + range.words());
      value[static_cast<int>(k)] = *number;
    }
    if (lab) {
      const cmsCIELab measured{value[0], value[1], value[2]};
      cmsCIEXYZ converted{};
      cmsLab2XYZ(nullptr, &converted, &measured);
      patches.emplace_back(converted.X, converted.Y, converted.Z);
    } else {
      patches.push_back(value / 100);
    }
  }
  return patches;
}

constexpr const char* kNoVolume = "patches lie in one plane, or outside of what textures hold";

PrintGamut read_gamut_word(const std::string& text) {
  const bool path = text.find('/') != std::string::npos || text.find('.') != std::string::npos;
  if (!path)
    return read_gamut(shipped_choice("scenes/prints", kChartFile, text, kGamutField,
                                     "a file (ICC profile or CGATS text) or box:BLACK,WHITE"),
                      text);
  if (printable(text) != text)
    throw FieldError(kGamutField, printable(text), "has letters that no settings file can hold", "rename it");
  if (!fs::is_regular_file(text)) throw FieldError(kGamutField, text, "no such file", kCharts);
  return read_gamut(text, fs::absolute(text).lexically_normal().string());
}

PrintGamut read_gamut_box(const std::string& text) {
  const std::vector<std::string> words = listed_words(text.substr(std::string(kBox).size()));
  const auto number = [&](std::size_t i) {
    return words.size() == 2 ? number_in(words[i]).value_or(-1) : -1;
  };
  return PrintGamut::box(number(0), number(1), text);
}

/// Standard deviation of the Gaussian that smooths an optimiser's step, as a share of the box's half height.
constexpr double kReach = 0.3;
/// Distance from a side over which steps towards it fade out, as a share of the box's half height.
constexpr double kMargin = 0.2;
/// Factor on the optimiser's rate, because averaging over neighbours shortens steps.
constexpr double kRate = 1.5;
/// m above the minimum thickness: thinner walls are already moved apart.
constexpr double kReserve = 0.005;

/// The field's mean around each vertex, weighted by a Gaussian of the distance in space.
std::vector<Vec3d> smoothed(const std::vector<Vec3d>& vertices, const std::vector<Vec3d>& field,
                            double reach) {
  std::vector<Vec3d> result(field.size(), Vec3d::Zero());
  for (std::size_t i = 0; i < field.size(); ++i) {
    double sum = 0;
    for (std::size_t k = 0; k < field.size(); ++k) {
      const double weight = std::exp(-(vertices[i] - vertices[k]).squaredNorm() / (2 * reach * reach));
      sum += weight;
      result[i] += weight * field[k];
    }
    result[i] /= sum;
  }
  return result;
}

void print(TexturedMesh& adversary, const BuildableSettings& settings) {
  for (Vec3d& t : adversary.atlas.texels) t = settings.gamut.nearest(t);
}

/// Vertices of the faces that break a rule.
std::set<int> offenders(const Mesh& mesh, double min_thickness) {
  std::set<int> vertices;
  const auto add = [&](int face) {
    const Face& f = mesh.faces[as_size(face)];
    vertices.insert(f.begin(), f.end());
  };
  for (const auto& pair : intersecting_faces(mesh)) {
    add(pair[0]);
    add(pair[1]);
  }
  const std::vector<Wall> face_walls = walls(mesh);
  for (std::size_t f = 0; f < face_walls.size(); ++f)
    if (face_walls[f].thickness < min_thickness) {
      add(static_cast<int>(f));
      add(face_walls[f].opposite);
    }
  return vertices;
}

/// Keeps base vertices (those on the floor in `before`) on the floor, to the bit, and all others above it.
void pin_base(std::vector<Vec3d>& vertices, const Mesh& before) {
  const std::vector<Vec3d>& old = before.vertices;
  const double floor = bounds(before).min().z(),
               above = std::nextafter(floor, std::numeric_limits<double>::infinity());
  for (std::size_t i = 0; i < vertices.size(); ++i)
    vertices[i].z() = old[i].z() <= floor ? floor : std::max(vertices[i].z(), above);
}

/// m², area of the faces with all corners at the lowest height.
double base_area(const Mesh& mesh) {
  const double floor = bounds(mesh).min().z();
  const std::vector<Vec3d> normals = face_normals(mesh);
  double area = 0;
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const Face& face = mesh.faces[f];
    if (std::ranges::all_of(face, [&](int v) { return mesh.vertices[as_size(v)].z() <= floor; }))
      area += normals[f].norm() / 2;
  }
  return area;
}

/// Moves the two sides of thin walls apart, along their vertices' normals and within the box.
void thicken(Mesh& mesh, const Mesh& before, double least, const AdversaryLimits& limits) {
  constexpr int kRounds = 4;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<double> lack(mesh.vertices.size(), 0);
    const std::vector<Wall> face_walls = walls(mesh);
    bool thin = false;
    for (std::size_t f = 0; f < face_walls.size(); ++f) {
      if (face_walls[f].thickness >= least) continue;
      thin = true;
      for (const std::size_t side : {f, as_size(face_walls[f].opposite)})
        for (const int v : mesh.faces[side]) {
          double& most = lack[as_size(v)];
          most = std::max(most, least - face_walls[f].thickness);
        }
    }
    if (!thin) return;
    std::vector<Vec3d> normals(mesh.vertices.size(), Vec3d::Zero());
    const std::vector<Vec3d> of_faces = face_normals(mesh);
    for (std::size_t f = 0; f < of_faces.size(); ++f)
      for (const int v : mesh.faces[f]) normals[as_size(v)] += of_faces[f];
    for (std::size_t i = 0; i < lack.size(); ++i)
      if (lack[i] > 0 && normals[i].norm() > 0)
        mesh.vertices[i] = (mesh.vertices[i] + 0.5 * lack[i] * normals[i].normalized())
                               .cwiseMax(-limits.half)
                               .cwiseMin(limits.half);
    pin_base(mesh.vertices, before);
  }
}

/// Returns vertices that break a rule to `old`, first halfway, then fully, until no face breaks one. A face
/// with all vertices back at `old` is as valid as before.
void revert_invalid_vertices(Mesh& mesh, const std::vector<Vec3d>& old, double min_thickness) {
  std::vector<int> returned(old.size(), 0);
  for (bool moved = true; moved;) {
    moved = false;
    for (const int i : offenders(mesh, min_thickness)) {
      const auto k = as_size(i);
      if (returned[k] >= 2) continue;
      mesh.vertices[k] = returned[k]++ == 0 ? Vec3d((mesh.vertices[k] + old[k]) / 2) : old[k];
      moved = true;
    }
  }
}

}  // namespace

std::optional<PrintGamut> PrintGamut::of(std::string name, const std::vector<Vec3d>& points) {
  const auto whole = ConvexPolytope::hull(points);
  const auto clipped = whole ? whole->within({Vec3d::Zero(), Vec3d::Ones()}) : std::nullopt;
  if (!clipped) return std::nullopt;
  // Rebuilt from its corners, so that a run which stores them gets the same facets.
  const auto again = ConvexPolytope::hull(clipped->corners());
  if (!again || again->corners().size() != clipped->corners().size()) return std::nullopt;
  PrintGamut gamut;
  gamut.name_ = std::move(name);
  gamut.solid_ = std::make_shared<const ConvexPolytope>(*again);
  return gamut;
}

PrintGamut PrintGamut::box(double black, double white, const std::string& text) {
  constexpr double kLeast = 1e-3;
  if (!kShare.contains(black) || !kShare.contains(white) || !(white - black >= kLeast))
    throw FieldError(kGamutField, text.empty() ? fmt::format("{}{},{}", kBox, black, white) : text,
                     "is not a range of reflectances", "use box:BLACK,WHITE, as box:0.03,0.85");
  std::vector<Vec3d> corners;
  corners.reserve(8);
  for (int i = 0; i < 8; ++i)
    corners.emplace_back(i & 1 ? white : black, i & 2 ? white : black, i & 4 ? white : black);
  return *of(fmt::format("{}{},{}", kBox, black, white), corners);
}

const ConvexPolytope& PrintGamut::solid() const {
  if (solid_) return *solid_;
  static const PrintGamut shipped = read_gamut_word(kDefaultGamut);
  return *shipped.solid_;
}

bool PrintGamut::holds(const Vec3d& texel) const {
  return solid().outside(texel) <= kInGamut;
}

Vec3d PrintGamut::nearest(const Vec3d& texel) const {
  return solid().nearest(texel).cwiseMax(0.0).cwiseMin(1.0);
}

void set_from_text(const std::string& text, PrintGamut& gamut) {
  gamut = text.starts_with(kBox) ? read_gamut_box(text) : read_gamut_word(text);
}

PrintGamut read_gamut(const fs::path& file, const std::string& name) {
  const std::string bytes = read_file(file, kMaxPrintFileBytes);
  constexpr std::size_t kSignature = 36;  // offset in the ICC header
  const bool profile = bytes.size() >= 128 && bytes.compare(kSignature, 4, "acsp") == 0;
  std::vector<Vec3d> points = profile ? patches_of_profile(bytes, file) : patches_of_chart(bytes, file);
  const Eigen::Matrix3d rgb = rgb_from_d50();
  for (Vec3d& patch : points) patch = rgb * patch;
  auto gamut = PrintGamut::of(name, points);
  if (!gamut)
    fail(file, profile ? "A2B1" : "BEGIN_DATA", kNoVolume, "measure at least paper, inks and black");
  return *gamut;
}

nlohmann::json to_json(const PrintGamut& gamut) {
  auto list = nlohmann::json::array();
  for (const Vec3d& c : gamut.colours()) list.push_back({c.x(), c.y(), c.z()});
  return list;
}

PrintGamut read_gamut(const nlohmann::json& written, const fs::path& file, const std::string& key,
                      const std::string& name) {
  const auto wrong = [&](std::size_t i) {
    fail(file, fmt::format("{}[{}]", key, i), "is not a colour",
         "restore the file: red, green and blue, 0 to 1 each");
  };
  if (!written.is_array() || written.size() > kMaxCorners)
    fail(file, key, "is not a list of colours", "restore the file");
  std::vector<Vec3d> points;
  for (const nlohmann::json& colour : written) {
    if (!colour.is_array() || colour.size() != 3) wrong(points.size());
    Vec3d point;
    for (std::size_t k = 0; k < 3; ++k) {
      if (!colour[k].is_number()) wrong(points.size());
      point[static_cast<int>(k)] = colour[k].get<double>();
      if (!kShare.contains(point[static_cast<int>(k)])) wrong(points.size());
    }
    points.push_back(point);
  }
  auto gamut = PrintGamut::of(name, points);
  if (!gamut) fail(file, key, kNoVolume, "restore the file");
  return *gamut;
}

void check_buildable(const BuildableSettings& settings, const AdversaryLimits& limits) {
  // Limit of the thickness for a start that fills 0.75 of the box.
  const double most = 0.5 * limits.half.minCoeff();
  if (!Range{0, most}.contains(settings.min_thickness))
    throw FieldError("min_thickness", fmt::format("{}", settings.min_thickness), "out of range",
                     fmt::format("use 0 to {:.3g} m", most));
}

void make_buildable(TexturedMesh& adversary, const BuildableSettings& settings,
                    const AdversaryLimits& limits) {
  const Eigen::AlignedBox3d box = bounds(adversary.mesh);
  const bool stands = base_area(adversary.mesh) > 0;
  const double floor = -limits.half.z(), cut = box.min().z() + (stands ? 0 : settings.base * box.sizes().z());
  for (Vec3d& v : adversary.mesh.vertices) v.z() = v.z() <= cut ? floor : v.z() - cut + floor;
  print(adversary, settings);
  if (!offenders(adversary.mesh, settings.min_thickness).empty())
    throw FieldError("min_thickness", fmt::format("{}", settings.min_thickness),
                     "the start is not a solid with walls that thick", "use a smaller one, or --free");
}

void step_buildable(Adam& adam, std::vector<Vec3d>& vertices, const std::vector<Vec3d>& gradient,
                    const AdversaryLimits& limits) {
  const double reach = kReach * limits.half.z(), margin = kMargin * limits.half.z();
  std::vector<Vec3d> way(vertices.size(), Vec3d::Zero());
  const double rate = adam.learning_rate;
  adam.learning_rate *= kRate;
  adam.step(way, smoothed(vertices, gradient, reach));
  adam.learning_rate = rate;
  way = smoothed(vertices, way, reach);
  for (std::size_t i = 0; i < vertices.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double room = limits.half[c] - std::copysign(vertices[i][c], way[i][c] * vertices[i][c]);
      vertices[i][c] += way[i][c] * std::clamp(room / margin, 0.0, 1.0);
    }
}

void keep_buildable(TexturedMesh& adversary, const TexturedMesh& before, const BuildableSettings& settings,
                    const AdversaryLimits& limits) {
  Mesh& mesh = adversary.mesh;
  print(adversary, settings);
  pin_base(mesh.vertices, before.mesh);
  thicken(mesh, before.mesh, settings.min_thickness + kReserve, limits);
  revert_invalid_vertices(mesh, before.mesh.vertices, settings.min_thickness);
}

TexturedMesh random_baseline(std::uint64_t seed, const AdversaryLimits& limits,
                             const BuildableSettings& settings) {
  TexturedMesh random = random_adversary(seed, limits);
  if (!settings.on) return random;
  TexturedMesh start = initial_adversary(limits);
  const std::vector<Vec3d> ellipsoid = start.mesh.vertices;
  make_buildable(start, settings, limits);
  for (std::size_t i = 0; i < ellipsoid.size(); ++i)
    random.mesh.vertices[i] += start.mesh.vertices[i] - ellipsoid[i];
  project(random, limits);
  keep_buildable(random, start, settings, limits);
  return random;
}

BuildableReport buildable_report(const TexturedMesh& adversary, const BuildableSettings& settings) {
  const Mesh& mesh = adversary.mesh;
  BuildableReport report;
  report.intersecting_pairs = intersecting_faces(mesh).size();
  report.watertight = is_watertight(mesh);
  report.min_thickness = 1e9;
  for (const Wall& wall : walls(mesh)) report.min_thickness = std::min(report.min_thickness, wall.thickness);
  report.base_area = base_area(mesh);
  const double floor = bounds(mesh).min().z();
  for (const std::size_t i : used_vertices(mesh)) report.base_vertices += mesh.vertices[i].z() <= floor;
  const std::vector<Vec3d>& texels = adversary.atlas.texels;
  const auto within = std::ranges::count_if(texels, [&](const Vec3d& t) { return settings.gamut.holds(t); });
  report.printable =
      static_cast<double>(within) / static_cast<double>(std::max<std::size_t>(1, texels.size()));
  return report;
}

}  // namespace mirage
