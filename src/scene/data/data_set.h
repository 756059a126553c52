// Data sets: folders of frames in one of the layouts that Mirage reads. One class defines each layout
// (kitti.cpp, kitti_drives.cpp, nuscenes.cpp, separate_labels.cpp); read_frames.h opens them.
//
//   kitti-object    DATA/training/{image_2,velodyne,calib,label_2}, and what Mirage adds to it (kitti.h)
//   kitti-tracking  DATA/training/{image_02,velodyne,calib,label_02}, a folder or file for each sequence
//   kitti-raw       DATA/[DATE/]calib_*.txt, DATA/[DATE/]DATE_drive_NNNN_sync/…, labels from its tracklets
//   nuscenes        DATA/v1.0-*/*.json, DATA/samples/…:
//                   keyframes of LIDAR_TOP and CAM_FRONT, and of the other cameras on request
//                   (with_all_cameras); sweeps between them (DataSet::sweeps)
// DATA/labels.json may name a set of any of these, whose unlabelled frames DATA/label_2 labels
// (separate_labels.cpp).
//
// KITTI's benchmarks may consist of DATA/testing alone, and pictures may be JPEG. Labels may be missing in
// any layout (Frame::labelled). DATA/dataset.json and DATA/rig.toml may name the rig that recorded a set of
// any layout (data_rig.h).
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "scene/frame.h"

namespace mirage {

/// Counts of 2-D boxes that differ from the label files (kitti_rows.h, label_of).
struct LabelNotes {
  int clipped = 0;    ///< reached past the picture's edge
  int projected = 0;  ///< were missing or outside the picture: projected from the 3-D boxes
};

/// Annotations of a frame: all but its sensors' measurements.
struct Annotations {
  Calibration calibration;
  std::vector<Label> labels;  ///< with track ids if the set has them
  bool labelled = true;       ///< false: the frame is unlabelled
  LabelNotes notes = {};
};

/// A data set of one layout. It holds a path and no frame. Thread-safe.
class DataSet {
 public:
  /// `data`: the set's folder.
  explicit DataSet(std::filesystem::path data) : data_(std::move(data)) {}
  virtual ~DataSet() = default;

  /// "kitti-object"
  virtual const char* layout() const = 0;
  /// Ids of the frames, sorted. InputError if there are none.
  virtual std::vector<std::string> frames() const = 0;
  /// frames() and the sweeps between them that have no labels of their own: in nuScenes, 20 a second.
  virtual std::vector<std::string> sweeps() const { return frames(); }
  /// The rig of sets of this layout (scenes/rigs), unless the set itself names one.
  virtual std::string rig() const { return "kitti64"; }

  /// A file of a frame, and the part of the frame that it holds.
  struct SourceFile {
    std::filesystem::path file;
    const char* what;  ///< "the sweep"
  };
  /// Files of a frame: its sweep, its picture and its annotation files. An unlabelled frame has no label
  /// file.
  virtual std::vector<SourceFile> source_files(const std::string& id) const = 0;
  /// Calibration and labels, read without sweep and picture. InputError naming file and field.
  virtual Annotations annotations(const std::string& id, int width, int height) const = 0;
  /// The frame's sweep in `velo`.
  virtual Sweep sweep(const std::string& id) const = 0;
  /// The frame's own light; nullopt: it follows from the road (recorded_light.h).
  virtual std::optional<Lighting> lighting(const std::string& /*id*/) const { return {}; }
  /// A hash that changes with annotations() of the frame.
  virtual std::string annotations_hash(const std::string& id) const;
  /// Track ids of the frame's labels, in their order; nullopt if the set has none.
  virtual std::optional<std::vector<int>> tracks(const std::string& id) const;
  /// Time of the frame and pose of the car; nullopt if the set has none. InputError naming file and row for
  /// an invalid pose or time.
  virtual std::optional<Moment> moment(const std::string& /*id*/) const { return {}; }
  /// The frame of the same sequence that is `step` after this one (negative: before); nullopt if there is no
  /// such frame.
  virtual std::optional<std::string> beside(const std::string& /*id*/, int /*step*/) const { return {}; }
  /// The same set with all cameras of its frames (Cameras::all): labels in the first camera's view keep their
  /// numbers, and labels that only other cameras see follow. Null: its frames have one camera.
  virtual std::shared_ptr<const DataSet> with_all_cameras() const { return nullptr; }
  /// The cameras after the first.
  virtual std::vector<SideCamera> others(const std::string& /*id*/) const { return {}; }
  /// The first camera's name.
  virtual std::string camera() const { return "camera"; }
  /// A line on the frames that frames() leaves out because their files are incomplete; empty: none.
  virtual std::string incomplete() const { return ""; }

  /// The whole frame. A label's velocity is the central difference of its positions in the frames before and
  /// after, or a one-sided difference if only one shows it, as in nuScenes' devkit. InputError naming file,
  /// field and fix, for: a missing file; a sweep that is cut off or has other columns (kitti.h, read_sweep);
  /// a calibration that is invalid or contradicts the picture's size; a label that no vehicle can have.
  Frame read(const std::string& id) const;
  /// The picture's width and height, from its header.
  std::pair<int, int> picture_size(const std::string& id) const;
  /// Hash of a frame's sweep, picture, annotations and moment, without its lighting and its labels' track ids
  /// and velocities. InputError for a missing file.
  std::string hash(const std::string& id) const;

  /// The folder.
  const std::filesystem::path& data() const { return data_; }

 protected:
  /// InputError if `id` cannot be a frame's name.
  void check_id(const std::string& id) const;
  /// Sets the velocities of labels with a track id that the neighbouring frames show, too.
  void add_velocities(const std::string& id, Frame& frame) const;
  /// source_files(). InputError if one is missing.
  std::vector<SourceFile> existing_files(const std::string& id) const;

 private:
  std::filesystem::path data_;
};

// Names of classes: KITTI's types, and the map to them from other data sets' names.

/// KITTI's word for a class, from its name in KITTI, nuScenes (category or detection name), Waymo or
/// Argoverse (1 and 2), in any case: "vehicle.bus.rigid" is "Bus", for which KITTI has no word. Returns an
/// unknown name unchanged. KITTI's development kit compares types without case, too.
std::string kitti_type(std::string_view name);
/// Whether the table has the name.
bool is_known_type(std::string_view name);
/// Whether it is the type of a motor vehicle: Car, Van, Truck, Tram or Bus.
bool is_vehicle_type(std::string_view type);

/// The classes in a list of names ("Car,Van,truck"), each mapped by kitti_type. FieldError for an empty list.
std::vector<std::string> classes_of(const std::string& list);
/// Marks the labels of these classes as sought, and the others as not (Label::sought).
void mark_sought(const std::vector<std::string>& classes, std::vector<Label>& labels);
/// The default classes.
inline constexpr const char* kCars = "Car";
/// The help of the option --classes.
inline constexpr const char* kClassesHelp =
    "label classes that carry the object and must be detected, e.g. Car,Van,Truck";

/// Counts of labels by type: "41 vehicle.foo, 3 Pedestrian", the most frequent first, at most eight of them.
std::string type_counts(const std::map<std::string, int>& types);
/// The known types, for messages.
inline constexpr const char* kKnownTypes =
    "KITTI's types (Car, Van, Truck, Pedestrian, Person_sitting, Cyclist, Tram, Misc, DontCare) and the "
    "class names of nuScenes, Waymo and Argoverse";

}  // namespace mirage
