// A detector as the rest of Mirage sees it: sensor data in, detections out, gradients back.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/fields.h"
#include "base/image.h"
#include "detection/detector_settings.h"
#include "detection/matching.h"
#include "scene/data/data_set.h"
#include "scene/frame.h"

namespace mirage {

struct FrameSource;

/// One answer of a detector. Before non-maximum suppression it is called a proposal.
struct Detection : ObjectBoxes {
  Detection() = default;
  /// For a detector without heights, or one that finds boxes in the picture.
  Detection(const BevBox& from_above, double its_logit, const PictureBox& in_picture = {})
      : ObjectBoxes({from_above, 0, 0}, in_picture), logit(its_logit) {}
  double logit = 0;
  int type = 0;                        ///< which of Capabilities::types
  int identity = -1;                   ///< from a tracker: constant for an object; -1: unknown
  std::optional<Vec3d> velocity = {};  ///< m/s over ground along the axes of the ego frame
  double score() const;                ///< sigmoid(logit)
};

/// The inputs that a detector reads and the boxes that it finds.
struct Capabilities {
  bool reads_image = true, reads_points = true;
  /// Detection::box from above, and Detection::picture.
  bool finds_bev = true, finds_picture = false;
  bool knows_presence = false;  ///< SensorView::watched
  /// Empty: SensorView::clean saves it work. Otherwise the reason why every pass covers the whole frame.
  std::string why_whole = "its plugin knows no other passes";
  bool finds_heights = false;  ///< Box3::bottom and height of its boxes
  bool has_gradients = true;   ///< backward()
  bool remembers = false;      ///< its answers depend on previous frames (SensorView::continues)
  /// For an external detector (detection/process_detector.h): a text that changes with its network. It names
  /// its answers in the cache on disk; empty: they are not cached.
  std::string version = {};
  /// The sensors that it reads, by name; empty: every camera or LiDAR of the kinds above.
  std::vector<std::string> reads = {};
  bool names(const std::string& sensor) const;  ///< whether `reads` does
  std::vector<std::string> types = {"Car"};     ///< classes that it finds, named as in Label::type
  MatchBy judged_by = MatchBy::own;             ///< as DetectorOptions::matching asks
  /// How its boxes are compared: as asked, or from above, or in the picture if it finds no other boxes.
  Matching matching() const;
};

/// The frame without the object. A detector may cache its activations and recompute only those that the
/// object changes. Answers and gradient equal those of the whole pass up to rounding.
struct UnchangedInput {
  const ImageF* image = nullptr;
  std::span<const LidarPoint> points;
  std::uint64_t key = 0;  ///< the same for the same image, points and calibration
  PixelRect changed;      ///< outside it the pictures are equal; sweeps may differ anywhere
};

/// One sensor's measurement as a detector gets it; a view, not a copy.
struct SensorData {
  /// The kind of sensor; other: neither camera nor LiDAR, for example radar.
  enum class Kind { camera, lidar, other } kind = Kind::camera;  ///< of this sensor
  std::string name;
  const ImageF* image = nullptr;           ///< of a camera: scene-linear RGB; null: it saw nothing
  PinholeCamera camera = {};               ///< of a camera
  std::span<const LidarPoint> points;      ///< of a LiDAR: in the ego frame, whatever its mount
  std::span<const float> values = {};      ///< of any other: Measurement::data
  std::array<std::int64_t, 3> shape = {};  ///< of `values`; a last length of 0: there are two
  Transform sensor_from_ego = Transform::Identity();
  double time = 0;  ///< s, as Moment::time
};

/// A detector's input; views, not copies. `image` and `points` are the first camera's and the first LiDAR's.
struct SensorView {
  const ImageF* image = nullptr;       ///< scene-linear RGB
  std::span<const LidarPoint> points;  ///< ego frame
  const Calibration* calibration = nullptr;
  /// If given, backward() gives the gradient of the changed pixels and of the points that are not in the
  /// clean sweep, and may give zero elsewhere. The calibration is the same.
  const UnchangedInput* clean = nullptr;
  /// Places (m, `velo`) where a return may appear or vanish. backward() of a detector that knows_presence
  /// gives SensorGradient::presence for them. They do not change the answers.
  std::span<const LidarPoint> watched = {};
  /// The frame that the data belong to: its id, time and place. Null: unknown.
  const Frame* frame = nullptr;
  /// Data of the frame's other sensors that differ from the recorded ones, identified by name.
  std::vector<SensorData> others = {};
  /// Whether the previous pass was over the previous frame of the same sequence. If not, a detector that
  /// remembers resets.
  bool continues = false;
};

/// The frame with its own picture and sweep.
SensorView view_of(const Frame& frame);
/// The frame with `image` and `points` (e.g. simulate()'s) in place of its own; both must outlive the view.
SensorView view_of(const Frame& frame, const ImageF& image, std::span<const LidarPoint> points);

/// Names of the first camera and the first LiDAR.
inline constexpr const char *kFirstCamera = "camera", *kFirstLidar = "lidar";

/// All sensors of a view: the first camera and the first LiDAR; then the frame's sensors that the view has or
/// the detector names, cameras before measurements; then the view's other sensors. Each has the view's data,
/// or otherwise the recorded ones. The first camera has its name in the frame if the detector uses that name.
/// Without a calibration the camera is at the ego origin. InputError naming `who` if the detector names a
/// missing sensor.
std::vector<SensorData> sensors(const SensorView& view, const Capabilities& can, const std::string& who);
/// A sensor of the frame other than its first camera and its LiDAR, as recorded. `place` counts its other
/// cameras (Frame::others), then its measurements. `image` replaces a camera's recorded picture, which is
/// then not read.
SensorData sensor_beside(const Frame& frame, std::size_t place, const ImageF* image = nullptr);

/// InputError naming `who` if the detector names a sensor other than the frame's first camera and LiDAR: only
/// these two are changed.
void require_first_sensors(const Capabilities& can, const Frame& frame, const std::string& who);

/// d loss / d pixel (H×W×3) and d loss / d (x, y, z, reflectance) of each point.
struct SensorGradient {
  ImageF image;
  std::vector<std::array<float, 4>> points;
  std::vector<float> presence = {};  ///< d loss / d number of returns at each watched place; empty: unknown
  /// d loss / d SensorView::others, by name: H×W×3, 4 per point, or of Measurement::shape. A missing one is
  /// zero.
  std::map<std::string, std::vector<float>> others = {};
};

/// Ground truth for one training sample.
struct TrainingSample {
  SensorView input;
  /// The calibration's pixel_from_velo is applied to recorded_from_augmented · p: augmentation moves points
  /// and boxes by augmented_from_recorded and leaves the image alone.
  Eigen::Affine3d recorded_from_augmented = Eigen::Affine3d::Identity();
  std::vector<BevBox> boxes, ignore;
  /// Boxes in the picture, which augmentation leaves alone: vehicles that must be found there, and regions
  /// without loss.
  std::vector<PictureBox> picture_boxes = {}, picture_ignore = {};
  /// H×W, row-major: 1 where the pixel shows a vehicle, 0 where not; empty if the data set has no masks.
  std::span<const std::uint8_t> vehicle_mask = {};
  /// Identifies the picture, so that outputs of frozen parts of a network may be cached; 0: cache nothing.
  std::uint64_t picture_key = 0;
};

/// Mean loss of a step: the whole, and its terms.
struct TrainingLoss {
  double total = 0, score = 0, box = 0;
};

/// How strongly a detector's image features answer: Euclidean norms over the channels, one channel each.
struct ImageFeatures {
  ImageF map;  ///< in the image plane; value (column, row) covers `stride` pixels from (stride · column, …)
  double stride = 0;  ///< pixels; 0: the detector has no image features
  /// The features that fusion carries to the bird's-eye view: columns along x from x_min, rows along y from
  /// y_min of the region, square cells of `cell` m; 0 in cells without one.
  ImageF bev;
  double cell = 0;
};

/// A detector with its weights. For one thread at a time; share() gives another thread's.
class Detector {
 public:
  virtual ~Detector() = default;
  /// As the user gave it (DetectorOptions::detector).
  virtual std::string name() const = 0;
  /// Its inputs and outputs; constant over its lifetime.
  virtual Capabilities capabilities() const { return {}; }
  /// Searched region: x_min, x_max, y_min, y_max (m, `velo`).
  virtual std::array<double, 4> region() const = 0;
  /// Proposals with score > threshold. keep_graph prepares backward().
  virtual std::vector<Detection> forward(const SensorView& input, double score_threshold,
                                         bool keep_graph) = 0;
  /// VJP of the last forward(keep_graph = true); d_logits has one value a proposal. Failure if it has no
  /// gradients (Capabilities).
  virtual SensorGradient backward(std::span<const double> d_logits) = 0;
  /// One optimiser step on the mean loss of the samples. Failure if the plugin cannot train.
  virtual TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) = 0;
  /// Writes the weights, and the optimiser's state for resuming. Failure on a full disk or a read-only
  /// folder.
  virtual void save(const std::filesystem::path& file, bool with_optimiser) = 0;
  /// Another instance on the same weights, for another thread: a training step of either changes both. Null
  /// if the plugin cannot.
  virtual std::unique_ptr<Detector> share() { return nullptr; }
  /// Changes after each train_step of this instance or of one that shares its weights: cached answers are
  /// then stale.
  virtual std::uint64_t weights_version() const { return 0; }
  /// Empty (stride 0) if the detector has none or the plugin does not give them.
  virtual ImageFeatures image_features(const SensorView& /*input*/) { return {}; }
};

/// The word for DetectorOptions::weights that names the shipped weights fine-tuned on KITTI, whose licence
/// (CC BY-NC-SA) allows non-commercial use only. A file of that name is ./real.
inline constexpr const char* kRealWeights = "real";

/// Which detector, which weights, how it computes.
struct DetectorOptions {
  /// "lidar", "camera", "painted", "fusion", "late", "refined", "torchscript", "onnx", "clusters", a path
  /// to a plugin (*.so), or "exec:" and a command (detection/process_detector.h).
  std::string detector = "fusion";
  /// Empty: the shipped DETECTOR-RIG.weights; for a plugin's path the ones in weights/ beside it, or no
  /// weights if there are none of it. kRealWeights: DETECTOR-RIG-real.weights, fine-tuned on real frames. For
  /// "clusters": the weights of a picture network (detection/roi_fusion.h).
  std::filesystem::path weights;
  bool fresh = false;  ///< train from scratch: no weights are read
  std::uint64_t seed = 0;
  int threads = 0;  ///< 0: as set by set_thread_count
  /// `weights` are where a new training starts: its optimiser is fresh, and `fusion` may start from weights
  /// of `lidar` (the same network without its image branch, which then adds nothing at first).
  bool start = false;
  std::string rig = "kitti64";  ///< rig of the data (data_rig): chooses the shipped weights
  /// The sought classes (FrameSource::classes). Only those of the detector's classes that answer for them are
  /// used (answering_types). kEveryClass: all are used.
  std::string classes = kCars;
  /// Of convolutions, if the plugin supports it (detection/detector_settings.h): "float", "bfloat16",
  /// "double".
  std::string precision = kFloat;
  /// m; > 0: in a view with a clean one, activations further than this from the object's changes keep their
  /// clean values: faster, but approximate. 0: exact.
  double locality = 0;
  /// "none"; "jpeg:QUALITY" (1–100): the picture is compressed before the detector sees it; "ceiling:HEIGHT":
  /// everything more than HEIGHT m above the road is ignored (detection/defenses.h); "consistency":
  /// cross-checked with single-sensor detectors (detection/consistent_detector.h); "shadows": cross-checked
  /// with the sweep's solid bodies (detection/defenses.h); any other word chooses shipped weights that were
  /// trained to resist, DETECTOR-RIG-WORD.weights. Several are joined by '+' (detection/detector_settings.h).
  std::string defense = "none";
  /// Parts of a fresh or starting network, if the plugin has them: "denoising", "depth-gate"
  /// (detector_abi.h).
  std::vector<std::string> parts = {};
  /// Weights of a camera and of a lidar detector that the branches of a new training start from; may be
  /// empty.
  std::filesystem::path camera = {}, lidar = {};
  /// How its boxes are compared with each other and with labels (detection/matching.h).
  MatchBy matching = MatchBy::own;
  /// Memory for cached activations of clean frames, in MB, common to all instances on the same weights; 0:
  /// every pass covers the whole frame; −1: default_clean_memory(). Affects only speed.
  int clean_memory_mb = -1;
  /// Height of the recording LiDAR over the road, m ("ceiling:HEIGHT" needs it; for_data); 0: that of the
  /// shipped rig `rig`.
  double unit_height = 0;
};

/// A 64th of machine_memory(), shared among the processes of a run on this machine; 2048 MB at most.
int default_clean_memory();

/// DetectorOptions::classes: every class that the detector knows.
inline constexpr const char* kEveryClass = "*";

/// `options` for a data set: its rig, its LiDAR's height (lidar_of) if there is a ceiling, and its sought
/// classes; every class with Victim::object. Errors as data_rig's, lidar_of's and read_defense's.
DetectorOptions for_data(DetectorOptions options, const FrameSource& source);

/// DetectorOptions::unit_height, or that of the shipped rig, m. Errors as read_lidar_model's.
double unit_height_of(const DetectorOptions& options);

/// The detector's classes that answer for the sought ones: the class itself; for a class that it lacks, Car
/// if that is a motor vehicle or the detector has no Misc, otherwise Misc.
std::vector<std::string> answering_types(const std::vector<std::string>& types,
                                         const std::vector<std::string>& sought);

/// The user's options of a detector that is run, not trained.
template <class Visitor, FieldsOf<DetectorOptions> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "detector",
         .help =
             "lidar, camera, painted, fusion, late, refined, torchscript, onnx, clusters, a plugin "
             "(*.so), or a program of yours: \"exec:python3 my_detector.py\". A run notices when a file that "
             "the command names has changed. It does not notice changes in folders or -m modules"},
        s.detector);
  visit({.name = "weights",
         .help =
             "weights file, or real: the shipped ones fine-tuned on KITTI, for non-commercial use. clusters "
             "needs none; with a picture detector's weights (*.pt, *.onnx, or *.weights of camera) it "
             "tells which clusters are cars",
         .otherwise = "the shipped ones for the data set's rig",
         .word = kRealWeights},
        s.weights);
  visit(
      {.name = "defense",
       .help = "the detector's defence. none; jpeg:QUALITY; ceiling:HEIGHT ignores everything more than "
               "HEIGHT m above the road; consistency cross-checks with the lidar and camera detectors; "
               "shadows cross-checks with solid bodies in the sweep. Weights of mirage defend: adversarial, "
               "denoising, depth-gate, ceiling, roof-objects, picture-dropout. Combine with +, e.g. "
               "adversarial+shadows",
       .check = [](const std::string& text) { read_defense(text); }},
      s.defense);
  visit(
      {.name = "clean_memory",
       .help = "memory for cached feature maps of frames without the object, MB; makes a step about 3 times "
               "faster. 0: off; -1: a 64th of the machine's, 2048 at most",
       .range = {-1, 1 << 20},
       .decides = false,
       .matters = false},
      s.clean_memory_mb);
  visit({.name = "precision",
         .help = "precision of the detector's convolutions: float, bfloat16 (float where the processor lacks "
                 "it) or double (slow)",
         .lacking = kFloat,
         .check = check_precision},
        s.precision);
  visit(
      {.name = "locality",
       .help = "recompute features only within this distance of the object, m; faster, approximate. 0: exact",
       .range = {0, 100},
       .lacking = "0"},
      s.locality);
  visit({.name = "matching",
         .help =
             "how two boxes are compared for suppression, AP and attack success. bev, 3d, picture: IoU from "
             "above, of volumes, in the picture. centre: 1 - d / 4 m for centres d apart. own: bev, or "
             "picture for a detector with picture boxes alone",
         .lacking = "own"},
        s.matching);
}

/// The weights file that load_detector would read (empty for fresh weights, and for a detector without
/// weights). Errors as load_detector's.
std::filesystem::path weights_file(const DetectorOptions& options);

/// FieldError for a precision or a locality that the detector does not support: a program, a Python object,
/// or a shipped detector without Mirage's network. `has_clean`: whether views have a clean one; a locality
/// needs it.
void check_known_options(const DetectorOptions& options, bool has_clean);

/// Options of the detectors that load_detector loads beside this one: the single-sensor detectors of
/// "consistency", the picture network of "clusters", otherwise none. The former are the rig's shipped ones;
/// with kRealWeights those fine-tuned on real frames, if there are any. Errors as weights_file's.
std::vector<DetectorOptions> auxiliary_detectors(const DetectorOptions& options);

/// Hash of all weights that load_detector would read; for a detector without weights, of its plugin. Errors
/// as weights_file's.
std::string weights_hash(const DetectorOptions& options);

/// The plugin that load_detector would open. Errors as load_detector's.
std::filesystem::path plugin_file(const DetectorOptions& options);

/// Loads the plugin with dlopen. InputError, naming the file, when it is missing, unreadable, lacks the entry
/// point, has another ABI version, or its weights are missing or wrong; Failure when it throws or fails
/// later.
std::unique_ptr<Detector> load_detector(const DetectorOptions& options);

/// InputError naming `who` (a file, or a detector) and the first invalid proposal: a logit or a box that is
/// not finite, or, in the compared dimensions, sides that are not positive or longer than 1 km (pixels: 1e6),
/// or a place beyond 100 km. In the picture a box may have no area: clipping at the border can leave none.
void check_proposals(std::span<const Detection> proposals, Matching matching = {},
                     const std::string& who = "detector");

/// Non-maximum suppression: keeps the best-scored boxes, drops boxes of the same class that overlap a kept
/// one by more than `most`. Sorted by falling score (ties: input order). Checks them.
std::vector<Detection> suppress(std::vector<Detection> proposals, double most, Matching matching = {});
/// The same with Matching::same().
std::vector<Detection> suppress(std::vector<Detection> proposals, Matching matching = {});

}  // namespace mirage
