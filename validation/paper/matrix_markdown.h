// The text of a table by source and target.
#pragma once

#include <string>

#include "validation/paper/tables.h"

namespace mirage::paper {

/// Of a table whose rows have sources and targets: a Markdown matrix a quantity that has a net, with the
/// share and the net, and one of the vehicles; then what is missing and why.
std::string matrix_markdown(const TableResult& table);

}  // namespace mirage::paper
