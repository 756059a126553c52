// A detector as the rest of Mirage sees it: sensor data in, proposals out, gradients back.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/fields.h"
#include "base/image.h"
#include "detection/defense_words.h"
#include "detection/precision.h"
#include "geometry/box.h"
#include "geometry/picture_box.h"
#include "scene/frame.h"

namespace mirage {

/// One proposal of the network, before non-maximum suppression.
struct Proposal {
  BevBox box;
  double logit = 0;
  PictureBox picture = {};  ///< of a detector that finds boxes in the picture
  double score() const;     ///< sigmoid(logit)
};

/// Where boxes are compared: in the bird's-eye view (metres), or in the picture (pixels).
enum class Plane { bev, picture };
/// "bev", "picture".
std::string to_string(Plane plane);
/// The proposal's box there: Proposal::box, or the rectangle of Proposal::picture.
BevBox rectangle(const Proposal& proposal, Plane plane);

/// What a detector reads and finds.
struct Capabilities {
  bool reads_image = true, reads_points = true;
  bool finds_bev = true, finds_picture = false;  ///< Proposal::box, Proposal::picture
  bool knows_presence = false;                   ///< SensorView::watched
  /// Empty: SensorView::clean saves it work. Else why every pass is over the whole frame.
  std::string why_whole = "its plugin knows no other passes";
  /// Where it is judged: in the picture if it finds boxes nowhere else.
  Plane plane() const { return finds_bev ? Plane::bev : Plane::picture; }
};

/// The frame without the object: what a detector made of it may be kept, and only what the object changes
/// is computed anew. The answers and the gradient are those of the whole pass up to rounding.
struct CleanView {
  const ImageF* image = nullptr;
  std::span<const LidarPoint> points;
  std::uint64_t key = 0;  ///< the same for the same image, points and calibration
  PixelRect changed;      ///< outside it the pictures are the same; of the sweeps nothing is assumed
};

/// What a detector reads; views, not copies.
struct SensorView {
  const ImageF* image = nullptr;  ///< scene-linear RGB
  std::span<const LidarPoint> points;
  const Calibration* calibration = nullptr;
  /// If given, backward() gives the gradient of the changed pixels and of the points that are not in the
  /// clean sweep, and may give zero elsewhere. The calibration is the same.
  const CleanView* clean = nullptr;
  /// Places (m, `velo`) where a return may come or go: backward() of a detector that knows_presence says what
  /// one more there would change. The answers are the same with and without.
  std::span<const LidarPoint> watched = {};
};

/// d loss / d pixel (H×W×3) and d loss / d (x, y, z, reflectance) of each point.
struct SensorGradient {
  ImageF image;
  std::vector<std::array<float, 4>> points;
  std::vector<float> presence = {};  ///< d loss / d number of returns at each watched place; empty: not known
};

/// Ground truth for one training sample.
struct TrainingSample {
  SensorView input;
  /// The calibration's pixel_from_velo is applied to data_from_sample · p: augmentation moves points and
  /// boxes by sample_from_data and leaves the image alone.
  Eigen::Affine3d data_from_sample = Eigen::Affine3d::Identity();
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
  virtual std::vector<Proposal> forward(const SensorView& input, double score_threshold, bool keep_graph) = 0;
  /// VJP of the last forward(keep_graph = true); d_logits has one value a proposal.
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
  /// "lidar", "camera", "painted", "fusion", "late", "refined", "torchscript", or a path to a plugin (*.so)
  std::string detector = "fusion";
  /// Empty: the shipped ones, DETECTOR-RIG.weights. kRealWeights: those fine-tuned on real frames,
  /// DETECTOR-RIG-real.weights.
  std::filesystem::path weights;
  bool fresh = false;  ///< train from scratch: no weights are read
  std::uint64_t seed = 0;
  int threads = 0;  ///< 0: as set by set_thread_count
  /// `weights` are where a new training starts: its optimiser is fresh, and `fusion` may start from weights
  /// of `lidar` (the same network without its image branch, which then adds nothing at first).
  bool start = false;
  std::string rig = "kitti64";  ///< of the data the detector is to see (data_rig): chooses shipped weights
  /// Of convolutions, where the plugin knows it (detection/precision.h): "float", "bfloat16", "double".
  std::string precision = kFloat;
  /// m; > 0: of a view with a clean one, what the detector makes of places further than this from what the
  /// object changes is left as it was: quicker, and no longer exact. 0: nothing is left out.
  double locality = 0;
  /// "none"; "jpeg:QUALITY" (1–100): the picture is compressed before the detector sees it; "ceiling:HEIGHT":
  /// nothing above that many metres over the road is looked at (detection/ceiling_detector.h); "consistency":
  /// held against what each sensor says alone (detection/consistent_detector.h); "shadows": against the
  /// sweep's solid bodies (detection/shadow_detector.h); any other word chooses shipped weights that were
  /// trained to resist, DETECTOR-RIG-WORD.weights. Several are joined by '+' (detection/defense_words.h).
  std::string defense = "none";
  /// Parts of a fresh or starting network, where the plugin has them: "denoising", "depth-gate"
  /// (detector_abi.h).
  std::vector<std::string> parts = {};
  /// Weights of a camera and of a lidar detector that the branches of a new training start from; may be
  /// empty.
  std::filesystem::path camera = {}, lidar = {};
  /// Bytes of clean frames' activations that a detector and those that share its weights may keep, in MB; 0:
  /// every pass is over the whole frame. A matter of time alone.
  int clean_memory_mb = 2048;
};

/// What a user chooses of a detector that is not trained.
template <class Visitor, FieldsOf<DetectorOptions> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "detector",
         .help = "lidar, camera, painted, fusion, late, refined, torchscript or a plugin (*.so)"},
        s.detector);
  visit({.name = "weights",
         .help = "weights file (default: the shipped ones for the data set's rig), or real: the shipped ones "
                 "fine-tuned on KITTI, for non-commercial use",
         .word = kRealWeights},
        s.weights);
  visit(
      {.name = "defense",
       .help = "what the detector is defended by: none, jpeg:QUALITY, ceiling:HEIGHT (m over the road: what "
               "stands higher is not looked at), consistency (with the lidar and the camera detector), "
               "shadows (with the sweep's solid bodies), or shipped weights of mirage defend (adversarial, "
               "denoising, depth-gate, roof-objects, picture-dropout); several at once "
               "as adversarial+shadows",
       .check = check_defense},
      s.defense);
  visit({.name = "clean_memory",
         .help = "MB of what the detector makes of frames without the object that are kept, so that only "
                 "what the object changes is computed anew; 0: every pass is over the whole frame",
         .range = {0, 1 << 20},
         .decides = false,
         .matters = false},
        s.clean_memory_mb);
  visit({.name = "precision",
         .help = "of the detector's convolutions: float, bfloat16 (float where the processor lacks it), or "
                 "double, a slow reference",
         .lacking = kFloat,
         .check = check_precision},
        s.precision);
  visit({.name = "locality",
         .help = "m: what the detector makes of places further from the object's changes is left as it was, "
                 "which is quicker and an approximation; 0: nothing is left out",
         .range = {0, 100},
         .lacking = "0"},
        s.locality);
}

/// The weights file that load_detector would read (empty for fresh ones). Errors as load_detector's.
std::filesystem::path weights_file(const DetectorOptions& options);

/// What load_detector loads beside the detector, as options of their own: the witnesses of "consistency",
/// for everybody else none. They are the rig's shipped ones, those fine-tuned on real frames for the word
/// kRealWeights where there are any. Errors as weights_file's.
std::vector<DetectorOptions> witnesses(const DetectorOptions& options);

/// Of the content of all weights that load_detector would read. Errors as weights_file's.
std::string weights_hash(const DetectorOptions& options);

/// The plugin that load_detector would open. Errors as load_detector's.
std::filesystem::path plugin_file(const DetectorOptions& options);

/// Loads the plugin with dlopen. InputError, naming the file, when it is missing, unreadable, lacks the entry
/// point, has another ABI version, or its weights are missing or wrong; Failure when it throws or fails
/// later.
std::unique_ptr<Detector> load_detector(const DetectorOptions& options);

/// InputError naming `who` (a file, or a detector) and the first proposal that is none: a logit or a box that
/// is not finite, and where `plane` is judged sides that are not positive or longer than 1 km (pixels: 1e6),
/// or a place beyond 100 km. In the picture a box may have no area: what lies beyond its edge has none left.
void check_proposals(std::span<const Proposal> proposals, Plane plane = Plane::bev,
                     const std::string& who = "detector");

/// Non-maximum suppression of the (rotated) boxes of `plane`: keeps the best-scored boxes, drops those that
/// overlap a kept one by more than `max_iou`. Sorted by falling score (ties: input order). Checks them.
std::vector<Proposal> suppress(std::vector<Proposal> proposals, double max_iou, Plane plane = Plane::bev);
/// At an IoU of 0.1 in the bird's-eye view, where vehicles stand beside each other, and of 0.5 in the
/// picture, where they stand behind each other.
std::vector<Proposal> suppress(std::vector<Proposal> proposals, Plane plane = Plane::bev);

}  // namespace mirage
