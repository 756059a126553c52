// The text of a table by source and target.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace mirage::paper {

/// Of a table (table_json) with sources and targets: a Markdown matrix a quantity that has a net, with the
/// share and the net, and one of the vehicles; then what is missing and why.
std::string matrix_markdown(const nlohmann::json& table);

}  // namespace mirage::paper
