// The assignment problem: which rows belong to which columns (Kuhn, Naval Research Logistics Quarterly 2,
// 1955). Solved as a flow of least cost by successive shortest paths (Boost.Graph).
#pragma once

#include <Eigen/Core>
#include <limits>
#include <utility>
#include <vector>

namespace mirage {

/// Pairs (row, column), by rising row: as many as there can be, and of these choices the one of least total
/// cost. No row and no column is in two pairs. Pairs that cost more than `most`, or whose cost is no number,
/// are never made. Costs count to 1e-12 of their range.
std::vector<std::pair<int, int>> assign(const Eigen::MatrixXd& cost,
                                        double most = std::numeric_limits<double>::max());

}  // namespace mirage
