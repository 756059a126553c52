#include "data_archive.h"

#include <caffe2/serialize/inline_container.h>

#include <optional>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <tuple>

#include "archive_check.h"
#include "base/file_head.h"
#include "base/files.h"
#include "pickle_check.h"

namespace mirage {
namespace {

constexpr const char* kLetters = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.";

bool only(std::string_view text, std::string_view more) {
  return text.find_first_not_of(std::string(kLetters) + std::string(more)) == std::string_view::npos;
}

bool drop_head(std::string_view& text, std::string_view head) {
  if (!text.starts_with(head)) return false;
  text.remove_prefix(head.size());
  return true;
}

/// The name of a type, perhaps with types in brackets: nothing that could be called or computed.
bool is_type(std::string_view text) {
  return !text.empty() && only(text, "[], ") && text.find("torch.classes") == std::string_view::npos;
}

/// A line of a class that has fields and no methods.
bool declares_field(std::string_view line) {
  if (line.empty() || line == "class Module(Module):") return true;
  if (!drop_head(line, "  ")) return false;
  for (const char* list : {"__parameters__ = [", "__buffers__ = [", "__annotations__ = ["})
    if (drop_head(line, list)) return line.ends_with("]") && only(line.substr(0, line.size() - 1), "\", /");
  if (drop_head(line, "__annotations__[\"")) {  // of a field whose name is a number
    const auto end = line.find("\"] = ");
    return end != std::string_view::npos && only(line.substr(0, end), "/") && is_type(line.substr(end + 5));
  }
  const auto colon = line.find(" : ");
  return colon != std::string_view::npos && colon > 0 && only(line.substr(0, colon), "") &&
         is_type(line.substr(colon + 3));
}

bool declares_fields_only(std::string_view code) {
  while (!code.empty()) {
    const auto end = code.find('\n');
    if (!declares_field(code.substr(0, end))) return false;
    code.remove_prefix(end == std::string_view::npos ? code.size() : end + 1);
  }
  return true;
}

/// Whether a record's name is of those that LibTorch writes for tensors and plain values.
bool is_data(const std::string& name) {
  return name.starts_with("data/") || name == "data.pkl" || name == "constants.pkl" || name == "version" ||
         name == "byteorder" || name.ends_with(".debug_pkl");
}

/// Classes of LibTorch's own, whose __setstate__ is C++.
bool names_native_class(std::string_view pickle) {
  return pickle.find("torch.classes") != std::string_view::npos ||
         pickle.find("torch\nclasses") != std::string_view::npos;
}

std::string record(caffe2::serialize::PyTorchStreamReader& reader, const std::string& name) {
  const auto [bytes, size] = reader.getRecord(name);
  return {static_cast<const char*>(bytes.get()), size};
}

void refuse_code(const std::string& bytes) {
  std::istringstream in(bytes);
  caffe2::serialize::PyTorchStreamReader reader(&in);
  for (const std::string& name : reader.getAllRecords()) {
    if (is_data(name)) {
      if (name.ends_with(".pkl") && names_native_class(record(reader, name)))
        throw std::invalid_argument("an object of a native class");
    } else if (!name.starts_with("code/") || !name.ends_with(".py") ||
               !declares_fields_only(record(reader, name))) {
      throw std::invalid_argument(name);
    }
  }
  // Data, too, can lie about its sizes.
  const auto bytes_of_storage = [&](const std::string& key) -> std::optional<std::size_t> {
    if (!reader.hasRecord("data/" + key)) return std::nullopt;
    return std::get<1>(reader.getRecord("data/" + key));
  };
  check_pickle(record(reader, "data.pkl"), bytes_of_storage);
  if (reader.hasRecord("constants.pkl"))
    check_pickle(record(reader, "constants.pkl"), [](const std::string&) { return std::nullopt; });
}

}  // namespace

torch::serialize::InputArchive open_data_archive(const std::string& file, const torch::Device& device) {
  // A file that can't be read says why: its error is not one of those below.
  const std::string bytes = begins_with(file, "PK\x03\x04") ? read_file(file) : "";
  torch::serialize::InputArchive archive;
  try {
    // LibTorch takes another format by its first bytes; this one begins with a zip file's.
    if (bytes.empty()) throw std::runtime_error("no zip file");
    check_archive(bytes);
    refuse_code(bytes);
    std::istringstream in(bytes);
    archive.load_from(in, device);
  } catch (const std::invalid_argument&) {
    throw std::runtime_error(
        "holds code, and weights are data; it was not loaded (a TorchScript model is for --detector "
        "torchscript)");
  } catch (const ArchiveTooLarge& problem) {
    throw std::runtime_error(std::string(problem.what()) +
                             ", and was not loaded; restore it, or train anew with mirage train");
  } catch (const std::exception&) {
    throw std::runtime_error("not a readable weights file; restore it, or train anew with mirage train");
  }
  return archive;
}

}  // namespace mirage
