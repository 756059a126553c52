#include "tracking/tracker.h"

#include <Eigen/LU>
#include <algorithm>
#include <boost/graph/adjacency_list.hpp>
#include <boost/graph/successive_shortest_path_nonnegative_weights.hpp>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>

#include "base/angles.h"
#include "base/error.h"

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

}  // namespace

std::vector<std::pair<int, int>> assign(const Eigen::MatrixXd& cost, double most) {
  const auto rows = static_cast<std::size_t>(cost.rows()), columns = static_cast<std::size_t>(cost.cols());
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
        edges.push_back({{r, c},
                         add_unit_edge(graph, static_cast<std::size_t>(r), rows + static_cast<std::size_t>(c),
                                       std::llround((value - low) / unit))});
  boost::successive_shortest_path_nonnegative_weights(graph, source, sink);
  std::vector<std::pair<int, int>> pairs;
  for (const auto& [pair, edge] : edges)
    if (boost::get(boost::edge_residual_capacity, graph, edge) == 0) pairs.push_back(pair);
  return pairs;
}

namespace {

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

}  // namespace

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
    throw InputError("sequence", std::to_string(time), "is no later time than the frame's before",
                     "give the frames in order of time");
  const double frames = started_ ? (time - time_) / kFrame : 0;
  time_ = time;
  started_ = true;
  for (Track& track : tracks_) {
    predict(track, frames);
    track.said.detection = -1;
  }
  const bool by_iou = settings_.matching == TrackMatching::iou;
  Eigen::MatrixXd cost(static_cast<Eigen::Index>(detections.size()),
                       static_cast<Eigen::Index>(tracks_.size()));
  for (std::size_t d = 0; d < detections.size(); ++d)
    for (std::size_t t = 0; t < tracks_.size(); ++t) {
      const Box3 box = box_of(tracks_[t].x);
      const BevBox &a = detections[d].box.bev, &b = box.bev;
      cost(static_cast<Eigen::Index>(d), static_cast<Eigen::Index>(t)) =
          by_iou ? 1 - iou(detections[d].box, box) : std::hypot(a.x - b.x, a.y - b.y);
    }
  // As published: all are assigned first, and what is too far is taken apart then.
  const double most = by_iou ? 1 - settings_.least_iou : settings_.farthest;
  std::vector<bool> taken(detections.size(), false);
  for (const auto& [d, t] : assign(cost)) {
    if (cost(d, t) > most) continue;
    Track& track = tracks_[static_cast<std::size_t>(t)];
    const TrackedDetection& detection = detections[static_cast<std::size_t>(d)];
    update(track, detection.box);
    track.said.detection = d;
    track.said.score = detection.score;
    taken[static_cast<std::size_t>(d)] = true;
  }
  for (Track& track : tracks_) {
    TrackState& said = track.said;
    said.misses = said.detection < 0 ? said.misses + 1 : 0;
    said.hits += said.detection >= 0;
  }
  std::erase_if(tracks_, [&](const Track& track) { return track.said.misses >= settings_.death; });
  for (std::size_t d = 0; d < detections.size(); ++d) {
    if (taken[d]) continue;
    Track track;
    track.x << measured(detections[d].box), 0, 0, 0;
    track.p = Covariance::Zero();
    for (int i = 0; i < 10; ++i) track.p(i, i) = i < kMeasured ? kFirstBox : kFirstVelocity;
    track.said.id = ++born_;
    track.said.hits = 1;
    track.said.detection = static_cast<int>(d);
    track.said.score = detections[d].score;
    tracks_.push_back(std::move(track));
  }
  std::vector<TrackState> states;
  for (Track& track : tracks_) {
    track.said.box = box_of(track.x);
    track.said.velocity = track.x.tail<3>() / kFrame;
    track.said.confirmed = track.said.hits >= settings_.birth;
    states.push_back(track.said);
  }
  return states;
}

}  // namespace mirage
