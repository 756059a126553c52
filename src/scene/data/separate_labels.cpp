// Labels separate from their data set (layouts.h), for example a detector's output on an unlabelled set.
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kLabelsFile = "labels.json";

class SeparateLabels : public DataSet {
 public:
  SeparateLabels(fs::path data, std::shared_ptr<const DataSet> set)
      : DataSet(std::move(data)), set_(std::move(set)) {}

  const char* layout() const override { return set_->layout(); }
  std::string rig() const override { return data_rig(set_->data()); }
  std::vector<std::string> frames() const override { return set_->frames(); }
  std::vector<std::string> sweeps() const override { return set_->sweeps(); }
  std::string incomplete() const override { return set_->incomplete(); }
  std::string camera() const override { return set_->camera(); }
  std::vector<SideCamera> others(const std::string& id) const override { return set_->others(id); }
  std::shared_ptr<const DataSet> with_all_cameras() const override {
    auto whole = set_->with_all_cameras();
    return whole ? std::make_shared<SeparateLabels>(data(), std::move(whole)) : nullptr;
  }
  Sweep sweep(const std::string& id) const override { return set_->sweep(id); }
  std::optional<Lighting> lighting(const std::string& id) const override { return set_->lighting(id); }
  std::optional<Moment> moment(const std::string& id) const override { return set_->moment(id); }
  std::optional<std::string> beside(const std::string& id, int step) const override {
    return set_->beside(id, step);
  }

  std::vector<SourceFile> source_files(const std::string& id) const override {
    check_id(id);
    std::vector<SourceFile> files = set_->source_files(id);
    if (fs::exists(labels_file(id))) files.push_back({labels_file(id), "the labels"});
    return files;
  }

  Annotations annotations(const std::string& id, int width, int height) const override {
    Annotations result = set_->annotations(id, width, height);
    if (result.labelled || !fs::exists(labels_file(id))) return result;
    result.labels = read_labels(labels_file(id), result.calibration, &result.notes);
    result.labelled = true;
    return result;
  }

  std::string annotations_hash(const std::string& id) const override {
    std::string hashes = set_->annotations_hash(id);
    if (fs::exists(labels_file(id))) hashes += file_hash(labels_file(id), kMaxFileBytes);
    return hashes;
  }

  std::optional<std::vector<int>> tracks(const std::string& id) const override {
    if (fs::exists(labels_file(id))) return std::nullopt;
    return set_->tracks(id);
  }

 private:
  fs::path labels_file(const std::string& id) const { return data() / "label_2" / (id + ".txt"); }

  std::shared_ptr<const DataSet> set_;
};

}  // namespace

std::shared_ptr<const DataSet> open_separate_labels(const fs::path& data) {
  std::error_code error;
  const fs::path about = data / kLabelsFile;
  if (!fs::is_regular_file(about, error)) return nullptr;
  const nlohmann::json json = read_json(about, kMaxRecordBytes);
  const fs::path set = JsonFields(about, json, "make the labels again").text("data");
  if (!fs::is_directory(set, error) || fs::exists(set / kLabelsFile, error))
    throw InputError(about.string(), "data", set.string() + " is not a folder of a data set",
                     "write down where the data set is now");
  return std::make_shared<SeparateLabels>(data, open_data_set(set));
}

bool are_labels_of(const fs::path& folder, const fs::path& data, nlohmann::json about) {
  if (!fs::exists(folder / kLabelsFile)) return false;
  about["data"] = fs::absolute(data).lexically_normal().string();
  if (read_json(folder / kLabelsFile, kMaxRecordBytes) == about) return true;
  throw InputError((folder / kLabelsFile).string(), "", "the folder holds the labels of another run",
                   "give another --out");
}

void write_separate_labels(const fs::path& folder, const fs::path& data, nlohmann::json about) {
  about["data"] = fs::absolute(data).lexically_normal().string();
  for (const char* name : {"dataset.json", "rig.toml"})
    if (fs::exists(data / name)) write_file(folder / name, read_file(data / name));
  write_json(folder / kLabelsFile, about);
}

}  // namespace mirage
