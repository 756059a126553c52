// Data sets: folders of frames in one of the layouts that Mirage reads. What a layout is stands in one class
// (kitti.cpp, kitti_drives.cpp, nuscenes.cpp, separate_labels.cpp); read_frames.h opens them.
//
//   kitti-object    DATA/training/{image_2,velodyne,calib,label_2}, and what Mirage adds to it (kitti.h)
//   kitti-tracking  DATA/training/{image_02,velodyne,calib,label_02}, a folder or file for each sequence
//   kitti-raw       DATA/[DATE/]calib_*.txt, DATA/[DATE/]DATE_drive_NNNN_sync/…, labels from its tracklets
//   nuscenes        DATA/v1.0-*/*.json, DATA/samples/…:
//                   keyframes of LIDAR_TOP and CAM_FRONT, and of the other cameras where they are asked for
//                   (with_all_cameras); sweeps between them (DataSet::sweeps)
// DATA/labels.json may name a set of any of these, whose unlabelled frames DATA/label_2 labels
// (separate_labels.cpp).
//
// KITTI's benchmarks may lie there as DATA/testing alone, and pictures may be JPEG. Labels may be missing: of
// all layouts (Frame::labelled). DATA/dataset.json and DATA/rig.toml may say which rig recorded a set of any
// layout (data_rig.h).
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

/// Boxes in the picture that are not as the labels' files have them (kitti_rows.h, label_of).
struct LabelNotes {
  int clipped = 0;    ///< reached past the picture's edge
  int projected = 0;  ///< were missing or beside the picture: projected from the boxes in space
};

/// What is known of a frame beside what its sensors measured.
struct Annotations {
  Calibration calibration;
  std::vector<Label> labels;  ///< with their identities where the set knows them
  bool labelled = true;       ///< false: nobody has labelled the frame
  LabelNotes notes = {};
};

/// A data set of one layout. It holds a path and no frame; several threads may ask at once.
class DataSet {
 public:
  /// `data`: the set's folder.
  explicit DataSet(std::filesystem::path data) : data_(std::move(data)) {}
  virtual ~DataSet() = default;

  /// "kitti-object"
  virtual const char* layout() const = 0;
  /// Ids of the frames, sorted. InputError if there are none.
  virtual std::vector<std::string> frames() const = 0;
  /// Those, and the sweeps between them that are not labelled one by one: of nuScenes, 20 a second.
  virtual std::vector<std::string> sweeps() const { return frames(); }
  /// The rig that recorded sets of this layout, if the set itself does not say (scenes/rigs).
  virtual std::string rig() const { return "kitti64"; }

  /// A file of a frame, and what the frame misses without it.
  struct SourceFile {
    std::filesystem::path file;
    const char* what;  ///< "the sweep"
  };
  /// Files of a frame: its sweep, its picture, and those that hold its annotations. A frame that nobody has
  /// labelled has no file of labels.
  virtual std::vector<SourceFile> source_files(const std::string& id) const = 0;
  /// Calibration and labels, which neither sweep nor picture is read for. InputError naming file and field.
  virtual Annotations annotations(const std::string& id, int width, int height) const = 0;
  /// The frame's sweep in `velo`.
  virtual Sweep sweep(const std::string& id) const = 0;
  /// The frame's own light; none: it follows from the road (recorded_light.h).
  virtual std::optional<Lighting> lighting(const std::string& /*id*/) const { return {}; }
  /// Changes with anything that annotations() says of the frame.
  virtual std::string annotations_hash(const std::string& id) const;
  /// Identities of the frame's labels, in their order; none where the set does not know them.
  virtual std::optional<std::vector<int>> tracks(const std::string& id) const;
  /// When the frame was taken and where the car stood; none where the set does not say. InputError naming
  /// file and row for a pose or a time that is none.
  virtual std::optional<Moment> moment(const std::string& /*id*/) const { return {}; }
  /// The frame of the same sequence that is `step` after this one (negative: before); none where there is
  /// none.
  virtual std::optional<std::string> beside(const std::string& /*id*/, int /*step*/) const { return {}; }
  /// The same set with all cameras of its frames (Cameras::all): labels that the first camera sees keep their
  /// numbers, and those that only others see come after them. Null: its frames have one camera.
  virtual std::shared_ptr<const DataSet> with_all_cameras() const { return nullptr; }
  /// The cameras beside the first.
  virtual std::vector<SideCamera> others(const std::string& /*id*/) const { return {}; }
  /// The first camera's name.
  virtual std::string camera() const { return "camera"; }
  /// What frames() leaves out because the folder holds it in part, as a line; empty: nothing.
  virtual std::string incomplete() const { return ""; }

  /// The frame, whole. A label's velocity is the central difference of its places in the frames before and
  /// after, or the difference to the one of them that shows it, as nuScenes' devkit has it. InputError naming
  /// file, field and fix, for: a missing file; a sweep that is cut off or of other columns (kitti.h,
  /// read_sweep); a calibration that is none, or that the picture's size contradicts; a label that no vehicle
  /// can have.
  Frame read(const std::string& id) const;
  /// The picture's width and height, from its header.
  std::pair<int, int> picture_size(const std::string& id) const;
  /// Tells whether a frame is the same as before: a hash over its sweep, picture, annotations and moment (not
  /// of its lighting, nor of its labels' identities and velocities). InputError for a missing file.
  std::string hash(const std::string& id) const;

  /// The folder.
  const std::filesystem::path& data() const { return data_; }

 protected:
  /// InputError if `id` can be no frame's name.
  void check_id(const std::string& id) const;
  /// Velocities of the labels that have an identity, where their frame's neighbours show it too.
  void add_velocities(const std::string& id, Frame& frame) const;
  /// source_files(), all of which are there.
  std::vector<SourceFile> existing_files(const std::string& id) const;

 private:
  std::filesystem::path data_;
};

// Names of classes: KITTI's types, and which of them other data sets' names mean.

/// KITTI's word for a class by the name that KITTI, nuScenes (category or detection name), Waymo or Argoverse
/// (1 and 2) has for it, whatever its case: "vehicle.bus.rigid" is "Bus", which KITTI has no word for. A name
/// that the table lacks comes back as it is. KITTI's development kit compares types without case, too.
std::string kitti_type(std::string_view name);
/// Whether the table has the name.
bool is_known_type(std::string_view name);
/// Whether it is the type of a motor vehicle: Car, Van, Truck, Tram or Bus.
bool is_vehicle_type(std::string_view type);

/// The classes that a list of names says ("Car,Van,truck"), each as kitti_type has it. FieldError for a list
/// that names none.
std::vector<std::string> classes_of(const std::string& list);
/// Marks the labels of these classes as sought, and the others as not (Label::sought).
void mark_sought(const std::vector<std::string>& classes, std::vector<Label>& labels);
/// Classes where nobody asks for others.
inline constexpr const char* kCars = "Car";
/// The help of the option --classes.
inline constexpr const char* kClassesHelp =
    "label classes that carry the object and must be detected, e.g. Car,Van,Truck";

/// Counts of labels by type: "41 vehicle.foo, 3 Pedestrian", the most frequent first, at most eight of them.
std::string type_counts(const std::map<std::string, int>& types);
/// What types are known, for messages.
inline constexpr const char* kKnownTypes =
    "KITTI's types (Car, Van, Truck, Pedestrian, Person_sitting, Cyclist, Tram, Misc, DontCare) and the "
    "class names of nuScenes, Waymo and Argoverse";

}  // namespace mirage
