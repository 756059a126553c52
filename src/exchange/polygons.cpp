#include "exchange/polygons.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <numeric>
#include <optional>
#include <string_view>
#include <tuple>

#include "base/error.h"
#include "base/names.h"
#include "base/sizes.h"
#include "exchange/gltf_document.h"

namespace mirage {

/// The largest sum of the squares of corners of all polygons of more than four: cutting one takes time by it.
constexpr std::size_t kMaxClipOperations = std::size_t{1} << 27;

void Polygons::fail(const std::string& field, const std::string& problem, const std::string& fix) const {
  throw InputError(where_, field, problem, fix);
}

void Polygons::reserve(const Polygons& counted) {
  vertices_.reserve(counted.vertex_count_);
  corners_.reserve(counted.corner_count_);
  ends_.reserve(counted.face_count_);
}

void Polygons::add_vertex(const Vec3d& place) {
  if (!(place.cwiseAbs().maxCoeff() <= gltf_limits::kMaxCoordinate))
    fail(fmt::format("vertex {}", vertex_count_),
         fmt::format("is not within {:g} m", gltf_limits::kMaxCoordinate), "export the mesh in metres");
  ++vertex_count_;
  if (collected_) vertices_.push_back(place);
}

int Polygons::corner(double number) const {
  if (!(number >= 0 && number < std::numeric_limits<int>::max() && number == std::floor(number)))
    fail(fmt::format("face {}", face_count_),
         fmt::format("names vertex {:g}, which is not a vertex's number", number));
  return static_cast<int>(number);
}

void Polygons::check_corners(double count) const {
  if (!(count >= 1 && count <= kMaxFaceCorners && count == std::floor(count)))
    fail(fmt::format("face {}", face_count_),
         fmt::format("has {:g} corners, not 1 to {}", count, kMaxFaceCorners),
         "cut its polygons into triangles");
}

void Polygons::add_face(std::span<const int> corners) {
  check_corners(static_cast<double>(corners.size()));
  for (const int vertex : corners)
    if (corner(vertex) > largest_) largest_ = vertex, largest_of_ = face_count_;
  if (corners.size() > 4 && (cutting_ += corners.size() * corners.size()) > kMaxClipOperations)
    fail("faces", "are too many of too many corners", "cut its polygons into triangles");
  ++face_count_;
  corner_count_ += corners.size();
  if (!collected_) return;
  corners_.insert(corners_.end(), corners.begin(), corners.end());
  ends_.push_back(corners_.size());
}

void Polygons::finish() const {
  if (largest_ >= 0 && as_size(largest_) >= vertex_count_)
    fail(fmt::format("face {}", largest_of_), fmt::format("names vertex {} of {}", largest_, vertex_count_));
}

Polygons read_polygons(const std::filesystem::path& file, const std::string& where,
                       const std::function<void(FileCharacters&, Polygons&)>& read) {
  const auto once = [&](Polygons polygons) {
    FileCharacters from(file, kMaxMesh);
    read(from, polygons);
    polygons.finish();
    return polygons;
  };
  Polygons collected(where);
  collected.reserve(once(Polygons(where, false)));
  return once(std::move(collected));
}

Mesh triangulated(const Polygons& polygons) {
  Mesh mesh{polygons.vertices(), {}};
  std::vector<Vec3d> corners;
  for (std::size_t f = 0; f < polygons.face_count(); ++f) {
    const std::span<const int> polygon = polygons.face(f);
    if (polygon.size() == 3) {
      mesh.faces.push_back({polygon[0], polygon[1], polygon[2]});
      continue;
    }
    throw_if_interrupted("nothing was written");
    corners.clear();
    for (const int corner : polygon) corners.push_back(mesh.vertices[as_size(corner)]);
    for (const auto& [a, b, c] : triangulate_polygon(corners))
      mesh.faces.push_back({polygon[as_size(a)], polygon[as_size(b)], polygon[as_size(c)]});
  }
  return mesh;
}

Mesh welded(const Mesh& mesh) {
  const auto place = [&](std::size_t v) {
    const Vec3d& p = mesh.vertices[v];
    return std::tuple(p.x(), p.y(), p.z());
  };
  std::vector<std::size_t> order(mesh.vertices.size()), first(mesh.vertices.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return place(a) < place(b); });
  for (std::size_t i = 0; i < order.size(); ++i)
    first[order[i]] = i > 0 && place(order[i - 1]) == place(order[i]) ? first[order[i - 1]] : order[i];
  Mesh result;
  std::vector<int> number(mesh.vertices.size(), -1);
  for (const Face& face : mesh.faces) {
    std::array<std::size_t, 3> corners;
    for (std::size_t k = 0; k < 3; ++k) corners[k] = first[as_size(face[k])];
    if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0]) continue;
    Face& added = result.faces.emplace_back();
    for (std::size_t k = 0; k < 3; ++k) {
      int& own = number[corners[k]];
      if (own < 0) {
        own = static_cast<int>(result.vertices.size());
        result.vertices.push_back(mesh.vertices[corners[k]]);
      }
      added[k] = own;
    }
  }
  return result;
}

namespace {

constexpr std::size_t kMaxHeaderLength = 1 << 16, kMaxElements = 32, kMaxProperties = 256;

/// A number of a binary file.
struct Scalar {
  std::string_view name, other_name;
  std::size_t bytes;
  double (*value)(const char* raw);  ///< of so many bytes in this machine's order
};

template <class T>
constexpr Scalar scalar(std::string_view name, std::string_view other_name) {
  return {name, other_name, sizeof(T), [](const char* raw) {
            T value;
            std::memcpy(&value, raw, sizeof value);
            return static_cast<double>(value);
          }};
}

constexpr std::array kScalars = {
    scalar<std::int8_t>("char", "int8"),    scalar<std::uint8_t>("uchar", "uint8"),
    scalar<std::int16_t>("short", "int16"), scalar<std::uint16_t>("ushort", "uint16"),
    scalar<std::int32_t>("int", "int32"),   scalar<std::uint32_t>("uint", "uint32"),
    scalar<float>("float", "float32"),      scalar<double>("double", "float64")};

/// Null for a word that names none.
const Scalar* scalar_named(std::string_view word) {
  for (const Scalar& one : kScalars)
    if (word == one.name || word == one.other_name) return &one;
  return nullptr;
}

struct Property {
  std::string_view name;
  const Scalar* type;
  const Scalar* length;  ///< of a list: the type of its count; else null
};

struct Element {
  std::string_view name;
  std::uint64_t count = 0;
  std::vector<Property> properties;
};

enum class Form { text, little, big };

/// A position in the file that says what is wrong there.
class Cursor {
 public:
  Cursor(FileCharacters& from, const Polygons& into) : from_(from), into_(into) {}

  [[noreturn]] void fail(const std::string& field, const std::string& problem) const {
    into_.fail(field, problem);
  }
  std::uintmax_t left() const { return from_.left(); }
  /// Up to the header's end and the line's behind it.
  std::string header() {
    constexpr std::string_view kStart = "ply", kEnd = "end_header";
    std::string text;
    while (!from_.at_end() && text.size() < kMaxHeaderLength && !text.ends_with(kEnd)) {
      text.push_back(from_.current());
      next();
      if (text.size() == kStart.size() && text != kStart) fail("header", "is not a PLY file's");
    }
    if (text.size() < kStart.size()) fail("header", "is not a PLY file's");
    if (!text.ends_with(kEnd)) fail("header", fmt::format("has no end within {} bytes", kMaxHeaderLength));
    for (bool on = true; on && !from_.at_end(); next()) on = from_.current() != '\n';
    return text.substr(0, text.size() - kEnd.size());
  }
  void set_form(Form form) { form_ = form; }
  double number(const Scalar& type) { return form_ == Form::text ? text_number() : binary_number(type); }
  /// Before the values of a row, and behind them. A text's row is a line: a value too many or too few would
  /// move all that follow into each other's places.
  void begin_row() {
    if (form_ != Form::text) return;
    while (!from_.at_end() && (blank(from_.current()) || from_.current() == '\n')) next();
    if (from_.at_end()) fail("body", "ends too early");
  }
  void end_row() {
    if (form_ != Form::text) return;
    while (!from_.at_end() && blank(from_.current())) next();
    if (!from_.at_end() && from_.current() != '\n') fail(line(), "has more values than its element");
  }
  /// Behind the last row of a text nothing may follow.
  void end() {
    if (form_ != Form::text) return;
    while (!from_.at_end() && (blank(from_.current()) || from_.current() == '\n')) next();
    if (!from_.at_end()) fail(line(), "follows the last row that the header counts");
  }

 private:
  static bool blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }
  std::string line() const { return fmt::format("line {}", line_); }
  void next() {
    line_ += from_.current() == '\n';
    from_.next();
  }

  double text_number() {
    constexpr std::size_t kMaxNumberLength = 400;  // 1e308 without an exponent, and as much behind a point
    while (!from_.at_end() && blank(from_.current())) next();
    if (from_.at_end() || from_.current() == '\n') fail(line(), "has fewer values than its element");
    std::array<char, kMaxNumberLength> word;
    std::size_t size = 0;
    for (; !from_.at_end() && !blank(from_.current()) && from_.current() != '\n' && size < word.size();
         next())
      word[size++] = from_.current();
    const auto value = try_parse_number<double>({word.data(), size});
    if (!value || size == word.size()) fail(line(), "holds a word that is not a number");
    return *value;
  }
  double binary_number(const Scalar& type) {
    std::array<char, sizeof(double)> raw;
    const auto bytes = std::span(raw).first(type.bytes);
    for (char& c : bytes) {
      if (from_.at_end()) fail("body", "ends too early");
      c = from_.current();
      from_.next();
    }
    if ((form_ == Form::big) != (std::endian::native == std::endian::big)) std::ranges::reverse(bytes);
    return type.value(raw.data());
  }

  FileCharacters& from_;
  const Polygons& into_;
  Form form_ = Form::text;
  std::size_t line_ = 1;  ///< of a text, that the cursor stands in
};

/// Puts a line of the header into `elements`.
void take(const std::vector<std::string_view>& words, std::vector<Element>& elements, const Cursor& cursor) {
  if (words.front() == "element") {
    const auto count = words.size() == 3 ? try_parse_number<std::uint64_t>(words[2]) : std::nullopt;
    if (!count) cursor.fail("header", "has an element line that is not \"element NAME COUNT\"");
    if (elements.size() == kMaxElements)
      cursor.fail("header", fmt::format("has more than {} elements", kMaxElements));
    elements.push_back({words[1], *count, {}});
  } else if (words.front() == "property") {
    const bool list = words.size() == 5 && words[1] == "list";
    const Scalar* type = words.size() >= 3 ? scalar_named(words[words.size() - 2]) : nullptr;
    const Scalar* length = list ? scalar_named(words[2]) : nullptr;
    if (elements.empty() || !type || (list ? !length : words.size() != 3))
      cursor.fail("header", "has a property line that is not one");
    if (elements.back().properties.size() == kMaxProperties)
      cursor.fail("header", fmt::format("has an element of more than {} properties", kMaxProperties));
    elements.back().properties.push_back({words.back(), type, length});
  }
}

/// The elements of a header, which they refer to; `cursor` stands at the body's first byte.
std::vector<Element> elements_of(std::string_view header, Cursor& cursor) {
  std::vector<Element> elements;
  std::optional<Form> form;
  for (const std::string_view line : split(header, "\n")) {
    const auto words = split(line, " \t\r");
    if (words.empty()) continue;
    if (words.front() == "format" && words.size() >= 2) {
      if (words[1] == "ascii") form = Form::text;
      if (words[1] == "binary_little_endian") form = Form::little;
      if (words[1] == "binary_big_endian") form = Form::big;
    }
    take(words, elements, cursor);
  }
  if (!form) cursor.fail("header", "names no known format");
  cursor.set_form(*form);
  // Before room is made: an element takes its scalars at least, and a count for each list; of a text a digit
  // and what parts it from the next.
  std::uint64_t least = 0;
  for (const Element& element : elements) {
    std::uint64_t each = 0;
    for (const Property& property : element.properties)
      each += *form == Form::text ? 2 : (property.length ? property.length : property.type)->bytes;
    if (element.count > cursor.left() + 1 ||
        (least += element.count * std::max<std::uint64_t>(1, each)) > cursor.left() + 1)
      cursor.fail("header", fmt::format("claims {} of \"{}\", which the {} bytes behind it cannot hold",
                                        element.count, element.name.substr(0, 40), cursor.left()));
  }
  return elements;
}

void read_vertex(const Element& element, Cursor& cursor, Polygons& into) {
  Vec3d place = Vec3d::Constant(std::numeric_limits<double>::quiet_NaN());
  for (const Property& property : element.properties) {
    if (property.length) cursor.fail("vertex", "has a list");
    const double value = cursor.number(*property.type);
    if (property.name.size() == 1 && property.name[0] >= 'x' && property.name[0] <= 'z')
      place[property.name[0] - 'x'] = value;
  }
  if (!place.allFinite())
    cursor.fail(fmt::format("vertex {}", into.vertex_count()), "has no finite x, y and z");
  into.add_vertex(place);
}

void read_face(const Element& element, Cursor& cursor, Polygons& into) {
  std::array<int, kMaxFaceCorners> face;
  for (const Property& property : element.properties) {
    const double count = property.length ? cursor.number(*property.length) : 1;
    const bool corners = property.name == "vertex_indices" || property.name == "vertex_index";
    if (corners || count != 0) into.check_corners(count);
    const auto size = static_cast<std::size_t>(count);
    for (std::size_t k = 0; k < size; ++k) {
      const double value = cursor.number(*property.type);
      if (corners) face[k] = into.corner(value);
    }
    if (corners) into.add_face(std::span(face).first(size));
  }
}

}  // namespace

void read_ply(FileCharacters& from, Polygons& into) {
  Cursor cursor(from, into);
  const std::string header = cursor.header();
  for (const Element& element : elements_of(header, cursor)) {
    for (const Property& property : element.properties)
      if (property.name == "red" || property.name == "diffuse_red")
        into.leave_out(fmt::format("colours ({} of {})", property.name, element.name.substr(0, 40)));
    for (std::uint64_t i = 0; i < element.count && !element.properties.empty(); ++i) {
      cursor.begin_row();
      if (element.name == "vertex") {
        read_vertex(element, cursor, into);
      } else if (element.name == "face") {
        read_face(element, cursor, into);
      } else {
        for (const Property& property : element.properties) {
          const double count = property.length ? cursor.number(*property.length) : 1;
          if (!(count >= 0 && count <= static_cast<double>(cursor.left())))
            cursor.fail(std::string(element.name.substr(0, 40)), "has a list of an impossible length");
          for (auto k = static_cast<std::uint64_t>(count); k > 0; --k) cursor.number(*property.type);
        }
      }
      cursor.end_row();
    }
  }
  cursor.end();
}

}  // namespace mirage
