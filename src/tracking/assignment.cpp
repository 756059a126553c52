#include "tracking/assignment.h"

#include <algorithm>
#include <boost/graph/adjacency_list.hpp>
#include <boost/graph/successive_shortest_path_nonnegative_weights.hpp>
#include <cmath>
#include <cstdint>

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

}  // namespace mirage
