#include "validation/view/encode.h"

#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/error.h"

namespace mirage {

std::string base64(std::string_view bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  const auto byte = [&](std::size_t i) -> std::uint32_t {
    return i < bytes.size() ? static_cast<unsigned char>(bytes[i]) : 0;
  };
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::uint32_t three = byte(i) << 16 | byte(i + 1) << 8 | byte(i + 2);
    for (int k = 0; k < 4; ++k)
      text.push_back(i + static_cast<std::size_t>(k) > bytes.size() ? '='
                                                                    : kDigits[three >> (18 - 6 * k) & 63]);
  }
  return text;
}

std::string gzip(std::string_view bytes) {
  z_stream stream{};
  constexpr int kGzip = 16 + MAX_WBITS;
  if (deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, kGzip, 8, Z_DEFAULT_STRATEGY) != Z_OK)
    throw Failure("zlib", "could not start", "check the free memory");
  std::string out(deflateBound(&stream, bytes.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  const int status = deflate(&stream, Z_FINISH);
  out.resize(stream.total_out);
  deflateEnd(&stream);
  if (status != Z_STREAM_END) throw Failure("zlib", "did not finish", "report this as a bug");
  return out;
}

std::string packed_points(const Sweep& points, const std::vector<unsigned char>& instance) {
  const std::size_t n = points.size();
  std::string bytes(8 * n, '\0');
  for (int axis = 0; axis < 3; ++axis) {
    char* low = bytes.data() + 2 * n * static_cast<std::size_t>(axis);
    char* high = low + n;
    int before = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const int now = static_cast<int>(std::lround(100 * points[i].position()[axis]));
      const int step =
          now - before;  // two's complement in 17 bits at most: wraps to 16, and back in the page
      const auto wrapped = static_cast<std::int16_t>(static_cast<std::uint16_t>(step));
      const auto zigzag = static_cast<std::uint16_t>(wrapped < 0 ? -2 * wrapped - 1 : 2 * wrapped);
      low[i] = static_cast<char>(zigzag & 255);
      high[i] = static_cast<char>(zigzag >> 8);
      before = now;
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    bytes[6 * n + i] = static_cast<char>(std::lround(255 * std::clamp(points[i].reflectance, 0.0f, 1.0f)));
    bytes[7 * n + i] = static_cast<char>(instance[i]);
  }
  return bytes;
}

}  // namespace mirage
