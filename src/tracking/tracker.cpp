#include "tracking/tracker.h"

#include <Eigen/LU>
#include <algorithm>
#include <boost/graph/adjacency_list.hpp>
#include <boost/graph/successive_shortest_path_nonnegative_weights.hpp>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <string>

#include "base/error.h"
#include "base/sizes.h"

namespace mirage {
namespace {

using Traits = boost::adjacency_list_traits<boost::vecS, boost::vecS, boost::directedS>;
using EdgeData =
    boost::property<boost::edge_capacity_t, long,
                    boost::property<boost::edge_residual_capacity_t, long,
                                    boost::property<boost::edge_reverse_t, Traits::edge_descriptor,
                                                    boost::property<boost::edge_weight_t, std::int64_t>>>>;
using Graph = boost::adjacency_list<boost::vecS, boost::vecS, boost::directedS, boost::no_property, EdgeData>;

/// An edge for one unit and the one back that flows need.
Traits::edge_descriptor add_unit_edge(Graph& graph, std::size_t from, std::size_t to, std::int64_t weight) {
  const auto there = boost::add_edge(from, to, graph).first, back = boost::add_edge(to, from, graph).first;
  boost::put(boost::edge_capacity, graph, there, 1);
  boost::put(boost::edge_capacity, graph, back, 0);
  boost::put(boost::edge_reverse, graph, there, back);
  boost::put(boost::edge_reverse, graph, back, there);
  boost::put(boost::edge_weight, graph, there, weight);
  boost::put(boost::edge_weight, graph, back, -weight);
  return there;
}

constexpr double kFrame = 0.1;  // s: what the published settings count as one step
constexpr double kVelocityNoise = 0.01, kBoxNoise = 1, kMeasurementNoise = 1;  // diagonals of Q and R
constexpr double kFirstBox = 10, kFirstVelocity = 1e4;                         // diagonal of P₀
constexpr int kMeasured = 7;

using Measurement = Eigen::Matrix<double, kMeasured, 1>;

Measurement measured(const Box3& box) {
  Measurement z;
  z << box.bev.x, box.bev.y, box.bottom + box.height / 2, box.bev.yaw, box.bev.length, box.bev.width,
      box.height;
  return z;
}

template <class State>
Box3 box_of(const State& x) {
  return {{x[0], x[1], x[4], x[5], wrap_angle(x[3])}, x[2] - x[6] / 2, x[6]};
}

struct Sample {
  double time = 0, value = 0, sigma = 1;
};

/// One axis: (p, v) at each sample.
std::vector<Vec2d> smooth_axis(const std::vector<Sample>& samples, double density) {
  constexpr double kUnknownSpeed = 100;  // σ of the first velocity
  const std::size_t n = samples.size();
  std::vector<Vec2d> x(n), ahead(n);
  std::vector<Eigen::Matrix2d> p(n), p_ahead(n), f(n, Eigen::Matrix2d::Identity());
  for (std::size_t k = 0; k < n; ++k) {
    const double variance = samples[k].sigma * samples[k].sigma;
    if (k == 0) {
      ahead[k] = Vec2d(samples[k].value, 0);
      p_ahead[k] = Vec2d(1e3 * variance, kUnknownSpeed * kUnknownSpeed).asDiagonal();
    } else {
      const double dt = samples[k].time - samples[k - 1].time;
      f[k](0, 1) = dt;
      Eigen::Matrix2d q;
      q << dt * dt * dt / 3, dt * dt / 2, dt * dt / 2, dt;
      ahead[k] = f[k] * x[k - 1];
      p_ahead[k] = f[k] * p[k - 1] * f[k].transpose() + density * q;
    }
    const Vec2d gain = p_ahead[k].col(0) / (p_ahead[k](0, 0) + variance);
    x[k] = ahead[k] + gain * (samples[k].value - ahead[k][0]);
    p[k] = p_ahead[k] - gain * p_ahead[k].row(0);
  }
  for (std::size_t k = n - 1; k-- > 0;)
    x[k] += p[k] * f[k + 1].transpose() * p_ahead[k + 1].inverse() * (x[k + 1] - ahead[k + 1]);
  return x;
}

/// Twice: the second time with weights by how far off each sample was.
std::vector<Vec2d> robust_axis(std::vector<Sample> samples, double density) {
  constexpr double kFar = 2;  // σ
  const std::vector<Vec2d> first = smooth_axis(samples, density);
  for (std::size_t k = 0; k < samples.size(); ++k) {
    const double off = std::abs(samples[k].value - first[k][0]) / samples[k].sigma;
    samples[k].sigma *= std::sqrt(std::max(1.0, off / kFar));
  }
  return smooth_axis(samples, density);
}

constexpr double kTiny = 1e-12;  // a similarity that equals a threshold matches
constexpr int kAlphas = 19;

/// The pairs of positive gain with the largest total.
std::vector<std::pair<int, int>> most_alike(const Eigen::MatrixXd& gain) {
  // A pair without gain costs as much as none: it fills up the assignment and is dropped then.
  auto pairs = assign(-gain);
  std::erase_if(pairs, [&](const auto& pair) { return !(gain(pair.first, pair.second) > kTiny); });
  return pairs;
}

void add_clear(std::span<const TrackFrame> frames, double least, TrackScores& scores) {
  constexpr double kKept = 1000;    // more than all similarities of a frame
  std::map<int, int> last, before;  // the track that matched a truth: ever, and in the frame before
  struct Seen {
    int frames = 0, matched = 0, pieces = 0;
  };
  std::map<int, Seen> seen;
  double similarity = 0;
  for (const TrackFrame& frame : frames) {
    Eigen::MatrixXd gain = frame.similarity;
    for (Eigen::Index t = 0; t < gain.rows(); ++t)
      for (Eigen::Index k = 0; k < gain.cols(); ++k) {
        const auto kept = before.find(frame.truths[as_size(t)]);
        const bool same = kept != before.end() && kept->second == frame.tracks[as_size(k)];
        gain(t, k) = gain(t, k) < least - kTiny ? 0 : gain(t, k) + (same ? kKept : 0);
      }
    for (const int truth : frame.truths) ++seen[truth].frames;
    std::map<int, int> now;
    for (const auto& [t, k] : most_alike(gain)) {
      const int truth = frame.truths[as_size(t)], track = frame.tracks[as_size(k)];
      const auto earlier = last.find(truth);
      scores.switches += earlier != last.end() && earlier->second != track;
      Seen& of = seen[truth];
      of.pieces += !before.contains(truth);
      ++of.matched;
      now[truth] = last[truth] = track;
      similarity += frame.similarity(t, k);
    }
    const int matched = static_cast<int>(now.size());
    scores.matches += matched;
    scores.truths += static_cast<int>(frame.truths.size());
    scores.tracks += static_cast<int>(frame.tracks.size());
    before = std::move(now);
  }
  scores.misses = scores.truths - scores.matches;
  scores.false_positives = scores.tracks - scores.matches;
  for (const auto& [truth, of] : seen) {
    scores.fragments += std::max(0, of.pieces - 1);
    const double share = static_cast<double>(of.matched) / of.frames;
    scores.mostly_tracked += share > 0.8;
    scores.mostly_lost += share < 0.2;
  }
  scores.identities = static_cast<int>(seen.size());
  if (scores.truths > 0)
    scores.mota =
        1 - static_cast<double>(scores.misses + scores.false_positives + scores.switches) / scores.truths;
  if (scores.matches > 0) scores.motp = similarity / scores.matches;
}

void add_hota(std::span<const TrackFrame> frames, TrackScores& scores) {
  using Pair = std::pair<int, int>;
  std::map<int, double> truth_frames, track_frames;
  std::map<Pair, double> together;  // of truth and track: Σ similarity over all that either is similar to
  for (const TrackFrame& frame : frames) {
    for (const int truth : frame.truths) ++truth_frames[truth];
    for (const int track : frame.tracks) ++track_frames[track];
    const Eigen::MatrixXd& s = frame.similarity;
    const Eigen::VectorXd by_truth = s.rowwise().sum();
    const Eigen::RowVectorXd by_track = s.colwise().sum();
    for (Eigen::Index t = 0; t < s.rows(); ++t)
      for (Eigen::Index k = 0; k < s.cols(); ++k)
        if (const double all = by_truth[t] + by_track[k] - s(t, k); s(t, k) > 0 && all > kTiny)
          together[{frame.truths[as_size(t)], frame.tracks[as_size(k)]}] += s(t, k) / all;
  }
  const auto jaccard = [&](const Pair& pair, double both) {
    return both / (truth_frames.at(pair.first) + track_frames.at(pair.second) - both);
  };
  std::array<std::map<Pair, double>, kAlphas> matches;
  std::array<double, kAlphas> hits{};
  for (const TrackFrame& frame : frames) {
    Eigen::MatrixXd gain = frame.similarity;
    const auto pair_of = [&](Eigen::Index t, Eigen::Index k) {
      return Pair(frame.truths[as_size(t)], frame.tracks[as_size(k)]);
    };
    for (Eigen::Index t = 0; t < gain.rows(); ++t)
      for (Eigen::Index k = 0; k < gain.cols(); ++k)
        if (gain(t, k) > 0) gain(t, k) *= jaccard(pair_of(t, k), together.at(pair_of(t, k)));
    for (const auto& [t, k] : most_alike(gain))
      for (int a = 0; a < kAlphas; ++a)
        if (frame.similarity(t, k) >= 0.05 * (a + 1) - kTiny) {
          ++matches[as_size(a)][pair_of(t, k)];
          ++hits[as_size(a)];
        }
  }
  for (std::size_t a = 0; a < kAlphas; ++a) {
    double association = 0;
    for (const auto& [pair, count] : matches[a]) association += count * jaccard(pair, count);
    const double all = scores.truths + scores.tracks - hits[a];
    const double deta = all > 0 ? hits[a] / all : 0, assa = association / std::max(1.0, hits[a]);
    scores.deta += deta / kAlphas;
    scores.assa += assa / kAlphas;
    scores.hota += std::sqrt(deta * assa) / kAlphas;
  }
}

}  // namespace

std::vector<std::pair<int, int>> assign(const Eigen::MatrixXd& cost, double most) {
  const auto rows = as_size(cost.rows()), columns = as_size(cost.cols());
  double low = std::numeric_limits<double>::infinity(), high = -low;
  const auto allowed = [&](double value) { return std::isfinite(value) && value <= most; };
  for (Eigen::Index i = 0; i < cost.size(); ++i)
    if (const double value = cost.data()[i]; allowed(value))
      low = std::min(low, value), high = std::max(high, value);
  if (!(low <= high)) return {};
  // Whole numbers: what is left of a distance must not fall below zero by rounding.
  const double unit = high > low ? (high - low) / 1e12 : 1;
  const std::size_t source = rows + columns, sink = source + 1;
  Graph graph(sink + 1);
  for (std::size_t r = 0; r < rows; ++r) add_unit_edge(graph, source, r, 0);
  for (std::size_t c = 0; c < columns; ++c) add_unit_edge(graph, rows + c, sink, 0);
  std::vector<std::pair<std::pair<int, int>, Traits::edge_descriptor>> edges;
  for (int r = 0; r < cost.rows(); ++r)
    for (int c = 0; c < cost.cols(); ++c)
      if (const double value = cost(r, c); allowed(value))
        edges.push_back(
            {{r, c},
             add_unit_edge(graph, as_size(r), rows + as_size(c), std::llround((value - low) / unit))});
  boost::successive_shortest_path_nonnegative_weights(graph, source, sink);
  std::vector<std::pair<int, int>> pairs;
  for (const auto& [pair, edge] : edges)
    if (boost::get(boost::edge_residual_capacity, graph, edge) == 0) pairs.push_back(pair);
  return pairs;
}

void Tracker::predict(Track& track, double frames) const {
  Covariance f = Covariance::Identity();
  for (int axis = 0; axis < 3; ++axis) f(axis, kMeasured + axis) = frames;
  track.x = f * track.x;
  track.p = f * track.p * f.transpose();
  for (int i = 0; i < 10; ++i) track.p(i, i) += i < kMeasured ? kBoxNoise : kVelocityNoise;
}

void Tracker::update(Track& track, const Box3& box) const {
  Measurement innovation = measured(box) - track.x.head<kMeasured>();
  // A box that points the other way is the same box; so is one a whole turn on.
  double turn = wrap_angle(innovation[3]);
  if (std::abs(turn) > std::numbers::pi / 2) {
    track.x[3] += std::numbers::pi;
    turn = wrap_angle(turn - std::numbers::pi);
  }
  innovation[3] = turn;
  const Eigen::Matrix<double, kMeasured, kMeasured> s =
      track.p.topLeftCorner<kMeasured, kMeasured>() +
      kMeasurementNoise * Eigen::Matrix<double, kMeasured, kMeasured>::Identity();
  const Eigen::Matrix<double, 10, kMeasured> gain = track.p.leftCols<kMeasured>() * s.inverse();
  track.x += gain * innovation;
  track.x[3] = wrap_angle(track.x[3]);
  track.p -= gain * track.p.topRows<kMeasured>().eval();
}

std::vector<TrackState> Tracker::step(double time, std::span<const TrackedDetection> detections) {
  if (started_ && !(time > time_))
    throw InputError("sequence", std::to_string(time), "is not later than the time of the frame before",
                     "give the frames in order of time");
  const double frames = started_ ? (time - time_) / kFrame : 0;
  time_ = time;
  started_ = true;
  for (Track& track : tracks_) {
    predict(track, frames);
    track.state.detection = -1;
  }
  const bool by_iou = settings_.matching == TrackMatching::iou;
  Eigen::MatrixXd cost(static_cast<Eigen::Index>(detections.size()),
                       static_cast<Eigen::Index>(tracks_.size()));
  for (std::size_t d = 0; d < detections.size(); ++d)
    for (std::size_t t = 0; t < tracks_.size(); ++t) {
      const Box3 box = box_of(tracks_[t].x);
      const BevBox &a = detections[d].box.bev, &b = box.bev;
      cost(static_cast<Eigen::Index>(d), static_cast<Eigen::Index>(t)) =
          by_iou ? 1 - iou(detections[d].box, box) : horizontal_distance(a, b);
    }
  // As published: all are assigned first, and what is too far is taken apart then.
  const double most = by_iou ? 1 - settings_.least_iou : settings_.farthest;
  std::vector<bool> taken(detections.size(), false);
  for (const auto& [d, t] : assign(cost)) {
    if (cost(d, t) > most) continue;
    Track& track = tracks_[as_size(t)];
    const TrackedDetection& detection = detections[as_size(d)];
    update(track, detection.box);
    track.state.detection = d;
    track.state.score = detection.score;
    taken[as_size(d)] = true;
  }
  for (Track& track : tracks_) {
    TrackState& state = track.state;
    state.misses = state.detection < 0 ? state.misses + 1 : 0;
    state.hits += state.detection >= 0;
  }
  std::erase_if(tracks_, [&](const Track& track) { return track.state.misses >= settings_.death; });
  for (std::size_t d = 0; d < detections.size(); ++d) {
    if (taken[d]) continue;
    Track track;
    track.x << measured(detections[d].box), 0, 0, 0;
    track.p = Covariance::Zero();
    for (int i = 0; i < 10; ++i) track.p(i, i) = i < kMeasured ? kFirstBox : kFirstVelocity;
    track.state.id = ++born_;
    track.state.hits = 1;
    track.state.detection = static_cast<int>(d);
    track.state.score = detections[d].score;
    tracks_.push_back(std::move(track));
  }
  std::vector<TrackState> states;
  for (Track& track : tracks_) {
    track.state.box = box_of(track.x);
    track.state.velocity = track.x.tail<3>() / kFrame;
    track.state.confirmed = track.state.hits >= settings_.birth;
    states.push_back(track.state);
  }
  return states;
}

std::vector<SmoothPlace> smooth(std::span<const PlaceMeasurement> measurements) {
  // How fast the motion may change: q of x, y and z (m²/s³) and of the heading (rad²/s³).
  constexpr std::array kDensity = {0.5, 0.5, 0.02, 0.02};
  if (measurements.empty()) return {};
  for (std::size_t k = 0; k < measurements.size(); ++k) {
    if (k > 0 && !(measurements[k].time > measurements[k - 1].time))
      throw InputError("track", std::to_string(measurements[k].time), "is not later than the one before",
                       "give measurements in order of time");
    if (!(measurements[k].sigma.minCoeff() > 0 && measurements[k].yaw_sigma > 0))
      throw InputError("track", "sigma", "is not over 0", "say how large the noise is");
  }
  std::vector<SmoothPlace> places(measurements.size());
  std::vector<Sample> samples(measurements.size());
  for (int axis = 0; axis < 4; ++axis) {
    double yaw = measurements.front().yaw;
    for (std::size_t k = 0; k < samples.size(); ++k) {
      const PlaceMeasurement& m = measurements[k];
      yaw += wrap_angle(m.yaw - yaw);
      samples[k] =
          axis < 3 ? Sample{m.time, m.position[axis], m.sigma[axis]} : Sample{m.time, yaw, m.yaw_sigma};
    }
    const auto states = robust_axis(samples, kDensity[as_size(axis)]);
    for (std::size_t k = 0; k < states.size(); ++k) {
      if (axis < 3) {
        places[k].position[axis] = states[k][0];
        places[k].velocity[axis] = states[k][1];
      } else {
        places[k].yaw = wrap_angle(states[k][0]);
        places[k].yaw_rate = states[k][1];
      }
    }
  }
  return places;
}

double jitter(std::span<const Vec3d> places, std::span<const double> times) {
  double sum = 0;
  int count = 0;
  for (std::size_t k = 1; k + 1 < places.size(); ++k) {
    const double before = times[k] - times[k - 1], after = times[k + 1] - times[k];
    if (std::abs(after - before) > 0.1 * std::min(before, after)) continue;
    sum += (places[k - 1] - 2 * places[k] + places[k + 1]).squaredNorm();
    ++count;
  }
  return count > 0 ? std::sqrt(sum / (6 * count)) : 0;
}

TrackScores score_tracks(std::span<const TrackFrame> frames, double least) {
  for (const TrackFrame& frame : frames)
    if (frame.similarity.rows() != static_cast<Eigen::Index>(frame.truths.size()) ||
        frame.similarity.cols() != static_cast<Eigen::Index>(frame.tracks.size()))
      throw InputError("tracks", "similarity", "is not of as many rows as truths and columns as tracks",
                       "give one for each pair");
  TrackScores scores;
  add_clear(frames, least, scores);
  add_hota(frames, scores);
  return scores;
}

}  // namespace mirage
