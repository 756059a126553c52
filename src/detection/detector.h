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
  /// Of a detector that knows no heights, or of one that finds boxes in the picture.
  Detection(const BevBox& from_above, double its_logit, const PictureBox& in_picture = {})
      : ObjectBoxes({from_above, 0, 0}, in_picture), logit(its_logit) {}
  double logit = 0;
  int type = 0;                        ///< which of Capabilities::types
  int identity = -1;                   ///< of a tracker: the same for the same object; -1: not known
  std::optional<Vec3d> velocity = {};  ///< m/s over ground along the axes of the ego frame
  double score() const;                ///< sigmoid(logit)
};

/// What a detector reads and finds.
struct Capabilities {
  bool reads_image = true, reads_points = true;
  /// Detection::box from above, and Detection::picture.
  bool finds_bev = true, finds_picture = false;
  bool knows_presence = false;  ///< SensorView::watched
  /// Empty: SensorView::clean saves it work. Else why every pass is over the whole frame.
  std::string why_whole = "its plugin knows no other passes";
  bool finds_heights = false;  ///< Box3::bottom and height of its boxes
  bool has_gradients = true;   ///< backward()
  bool remembers = false;      ///< what it answers depends on the frames before (SensorView::continues)
  /// Of a detector outside (detection/process_detector.h): a text that changes with its network. Its answers
  /// may be kept on disk under it; empty: they may not.
  std::string version = {};
  /// The sensors that it reads, by name; empty: every camera or LiDAR of the kinds above.
  std::vector<std::string> reads = {};
  bool names(const std::string& sensor) const;  ///< whether `reads` does
  std::vector<std::string> types = {"Car"};     ///< classes that it finds, as Label::type has them
  MatchBy judged_by = MatchBy::own;             ///< as DetectorOptions::matching asks
  /// How its boxes are compared: as asked, or from above, or in the picture if it finds boxes nowhere else.
  Matching matching() const;
};

/// The frame without the object: what a detector made of it may be kept, and only what the object changes
/// is computed anew. The answers and the gradient are those of the whole pass up to rounding.
struct UnchangedInput {
  const ImageF* image = nullptr;
  std::span<const LidarPoint> points;
  std::uint64_t key = 0;  ///< the same for the same image, points and calibration
  PixelRect changed;      ///< outside it the pictures are the same; of the sweeps nothing is assumed
};

/// One sensor's measurement as a detector gets it; a view, not a copy.
struct SensorData {
  /// What the sensor is; other: neither camera nor LiDAR, as radar.
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

/// What a detector reads; views, not copies. `image` and `points` are the first camera's and the first
/// LiDAR's.
struct SensorView {
  const ImageF* image = nullptr;       ///< scene-linear RGB
  std::span<const LidarPoint> points;  ///< ego frame
  const Calibration* calibration = nullptr;
  /// If given, backward() gives the gradient of the changed pixels and of the points that are not in the
  /// clean sweep, and may give zero elsewhere. The calibration is the same.
  const UnchangedInput* clean = nullptr;
  /// Places (m, `velo`) where a return may come or go: backward() of a detector that knows_presence says what
  /// one more there would change. The answers are the same with and without.
  std::span<const LidarPoint> watched = {};
  /// The frame that this is of: its id, and when and where it was taken. Null: not known.
  const Frame* frame = nullptr;
  /// What the frame's other sensors saw where that is not as recorded; they are known by their names.
  std::vector<SensorData> others = {};
  /// Whether the pass before was over the frame before of the same sequence. A detector that remembers starts
  /// anew where it is not.
  bool continues = false;
};

/// The frame's own picture and sweep, or others in their place: those of simulate().
SensorView view_of(const Frame& frame);
/// The frame with `image` and `points` in place of its own; both outlive the view.
SensorView view_of(const Frame& frame, const ImageF& image, std::span<const LidarPoint> points);

/// Names of the first camera and the first LiDAR.
inline constexpr const char *kFirstCamera = "camera", *kFirstLidar = "lidar";

/// All sensors of a view: the first camera and the first LiDAR, then those of its frame that the view has or
/// the detector names, cameras before measurements and each as the view has it, else as recorded; then what
/// else the view has. The first camera is called as its frame calls it where the detector names that. Of a
/// view without a calibration the camera stands where the ego frame does. InputError of `who` where the
/// detector names one that there is not.
std::vector<SensorData> sensors(const SensorView& view, const Capabilities& can, const std::string& who);
/// One of the frame's sensors beside its first camera and its LiDAR, as recorded: its other cameras
/// (Frame::others), then its measurements. `image`: a camera's in place of the recorded one, which is not
/// read then.
SensorData sensor_beside(const Frame& frame, std::size_t place, const ImageF* image = nullptr);

/// InputError, naming `who`, for a detector that reads by name more than the frame's first camera and its
/// LiDAR, where those alone are changed.
void require_first_sensors(const Capabilities& can, const Frame& frame, const std::string& who);

/// d loss / d pixel (H×W×3) and d loss / d (x, y, z, reflectance) of each point.
struct SensorGradient {
  ImageF image;
  std::vector<std::array<float, 4>> points;
  std::vector<float> presence = {};  ///< d loss / d number of returns at each watched place; empty: not known
  /// d loss / d each of SensorView::others, by name: H×W×3, 4 per point, or of Measurement::shape. A missing
  /// one is zero.
  std::map<std::string, std::vector<float>> others = {};
};

/// Ground truth for one training sample.
struct TrainingSample {
  SensorView input;
  /// The calibration's pixel_from_velo is applied to recorded_from_augmented · p: augmentation moves points
  /// and boxes by augmented_from_recorded and leaves the image alone.
  Eigen::Affine3d recorded_from_augmented = Eigen::Affine3d::Identity();
  std::vector<BevBox> boxes, ignore;
  /// In the picture, which augmentation leaves alone: vehicles that must be found there, and regions that
  /// give no loss.
  std::vector<PictureBox> picture_boxes = {}, picture_ignore = {};
  /// H×W, row-major: 1 where the pixel shows a vehicle, 0 where not; empty where the data set does not tell.
  std::span<const std::uint8_t> vehicle_mask = {};
  /// The same for the same picture, so that what frozen parts of a network make of it may be kept; 0: keep
  /// nothing.
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
  /// Where fusion carries them in the bird's-eye view: columns along x from x_min, rows along y from y_min of
  /// the region, square cells of `cell` m; 0 where no point brings one.
  ImageF bev;
  double cell = 0;
};

/// A detector with its weights. For one thread at a time; share() gives another thread's.
class Detector {
 public:
  virtual ~Detector() = default;
  /// As the user gave it (DetectorOptions::detector).
  virtual std::string name() const = 0;
  /// What it reads and finds; the same as long as it lives.
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
  /// Another number after each train_step of it or of one that shares its weights: what was kept of its
  /// answers is then another network's.
  virtual std::uint64_t weights_version() const { return 0; }
  /// Empty (stride 0) where the detector has none or the plugin does not tell.
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
  /// Empty: the shipped ones, DETECTOR-RIG.weights; of a plugin's path those in weights/ beside it, or none
  /// where no weights of it lie there. kRealWeights: those fine-tuned on real frames,
  /// DETECTOR-RIG-real.weights. Of "clusters": a picture network's beside it (detection/roi_fusion.h).
  std::filesystem::path weights;
  bool fresh = false;  ///< train from scratch: no weights are read
  std::uint64_t seed = 0;
  int threads = 0;  ///< 0: as set by set_thread_count
  /// `weights` are where a new training starts: its optimiser is fresh, and `fusion` may start from weights
  /// of `lidar` (the same network without its image branch, which then adds nothing at first).
  bool start = false;
  std::string rig = "kitti64";  ///< of the data the detector is to see (data_rig): chooses shipped weights
  /// What has to be found there (FrameSource::classes): of a detector that tells several classes, those that
  /// answer for these are looked at (answering_types). kEveryClass: all are.
  std::string classes = kCars;
  /// Of convolutions, where the plugin knows it (detection/detector_settings.h): "float", "bfloat16",
  /// "double".
  std::string precision = kFloat;
  /// m; > 0: of a view with a clean one, what the detector makes of places further than this from what the
  /// object changes is left as it was: quicker, and no longer exact. 0: nothing is left out.
  double locality = 0;
  /// "none"; "jpeg:QUALITY" (1–100): the picture is compressed before the detector sees it; "ceiling:HEIGHT":
  /// nothing above that many metres over the road is looked at (detection/defenses.h); "consistency":
  /// held against what each sensor says alone (detection/consistent_detector.h); "shadows": against the
  /// sweep's solid bodies (detection/defenses.h); any other word chooses shipped weights that were
  /// trained to resist, DETECTOR-RIG-WORD.weights. Several are joined by '+' (detection/detector_settings.h).
  std::string defense = "none";
  /// Parts of a fresh or starting network, where the plugin has them: "denoising", "depth-gate"
  /// (detector_abi.h).
  std::vector<std::string> parts = {};
  /// Weights of a camera and of a lidar detector that the branches of a new training start from; may be
  /// empty.
  std::filesystem::path camera = {}, lidar = {};
  /// How its boxes are compared with each other and with labels (detection/matching.h).
  MatchBy matching = MatchBy::own;
  /// Bytes of clean frames' activations that a detector and those that share its weights may keep, in MB; 0:
  /// every pass is over the whole frame; −1: default_clean_memory(). A matter of time alone.
  int clean_memory_mb = -1;
  /// m over the road, of the LiDAR that recorded the data ("ceiling:HEIGHT" needs it; for_data); 0: that of
  /// the shipped rig `rig`.
  double unit_height = 0;
};

/// A 64th of machine_memory(), shared among the processes of a run on this machine; 2048 MB at most.
int default_clean_memory();

/// DetectorOptions::classes: every class that the detector knows.
inline constexpr const char* kEveryClass = "*";

/// `options` for a data set: its rig, under a ceiling its LiDAR's height (lidar_of), and the classes that are
/// sought; every class with Victim::object. Errors as data_rig's, lidar_of's and read_defense's.
DetectorOptions for_data(DetectorOptions options, const FrameSource& source);

/// DetectorOptions::unit_height, or that of the shipped rig, m. Errors as read_lidar_model's.
double unit_height_of(const DetectorOptions& options);

/// Those of a detector's classes that answer for the ones that are sought: the class itself; for one that it
/// has no word for, Car where that is a motor vehicle or the detector knows no other things, else Misc.
std::vector<std::string> answering_types(const std::vector<std::string>& types,
                                         const std::vector<std::string>& sought);

/// What a user chooses of a detector that is not trained.
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
  visit({.name = "defense",
         .help = "the detector's defence: none, jpeg:QUALITY, ceiling:HEIGHT (ignores everything more than "
                 "HEIGHT m above the road), consistency (cross-check with the lidar and camera detectors), "
                 "shadows (cross-check with solid bodies in the sweep), or shipped weights of mirage defend "
                 "(adversarial, denoising, depth-gate, ceiling, roof-objects, picture-dropout). Combine with "
                 "+, e.g. adversarial+shadows",
         .check = [](const std::string& text) { read_defense(text); }},
        s.defense);
  visit({.name = "clean_memory",
         .help = "memory for cached feature maps of frames without the object, MB; makes a step 2 to 4 times "
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
             "overlap of two boxes, for suppression, AP and attack success: bev (IoU from above), 3d (IoU of "
             "volumes), picture (IoU in the picture), centre (1 - d / 4 m, d between the centres) or "
             "own (bev, or picture if the detector finds no other boxes)",
         .lacking = "own"},
        s.matching);
}

/// The weights file that load_detector would read (empty for fresh ones, and for a detector that has none).
/// Errors as load_detector's.
std::filesystem::path weights_file(const DetectorOptions& options);

/// FieldError for a precision or a locality that a detector of these does not know: a program, one in Python,
/// or one that ships without convolutions of ours. `has_clean`: whether views come with a clean one, without
/// which no locality acts.
void check_known_options(const DetectorOptions& options, bool has_clean);

/// What load_detector loads beside the detector, as options of their own: the single-sensor detectors of
/// "consistency", the picture network of "clusters", for everybody else none. The former are the rig's
/// shipped ones; for the word kRealWeights those fine-tuned on real frames, where there are any.
/// Errors as weights_file's.
std::vector<DetectorOptions> auxiliary_detectors(const DetectorOptions& options);

/// Of the content of all weights that load_detector would read; of a detector that has none, of its plugin.
/// Errors as weights_file's.
std::string weights_hash(const DetectorOptions& options);

/// The plugin that load_detector would open. Errors as load_detector's.
std::filesystem::path plugin_file(const DetectorOptions& options);

/// Loads the plugin with dlopen. InputError, naming the file, when it is missing, unreadable, lacks the entry
/// point, has another ABI version, or its weights are missing or wrong; Failure when it throws or fails
/// later.
std::unique_ptr<Detector> load_detector(const DetectorOptions& options);

/// InputError naming `who` (a file, or a detector) and the first proposal that is none: a logit or a box that
/// is not finite, and where it is compared sides that are not positive or longer than 1 km (pixels: 1e6), or
/// a place beyond 100 km. In the picture a box may have no area: what lies beyond its edge has none left.
void check_proposals(std::span<const Detection> proposals, Matching matching = {},
                     const std::string& who = "detector");

/// Non-maximum suppression: keeps the best-scored boxes, drops those of the same class that are more alike to
/// a kept one than `most`. Sorted by falling score (ties: input order). Checks them.
std::vector<Detection> suppress(std::vector<Detection> proposals, double most, Matching matching = {});
/// The same with Matching::same().
std::vector<Detection> suppress(std::vector<Detection> proposals, Matching matching = {});

}  // namespace mirage
