// The plugin's one precompiled header: LibTorch takes most of a minute to parse.
#pragma once

#include <torch/torch.h>
