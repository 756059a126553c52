// A detector in a process of its own, in any language: `--detector "exec:python3 my_detector.py"`. Frames go
// by shared memory, words as JSON lines over its standard input and output; the protocol stands in
// plugins/process/mirage_process.h.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "detection/detector.h"

namespace mirage {

/// What DetectorOptions::detector begins with; the command follows, its words as in a shell.
inline constexpr const char* kProgramPrefix = "exec:";

/// Whether the word names a program, which is code.
bool is_program(const std::string& detector);

/// Hash of the command's words and of the files that they name: what the program reads besides is not in it.
/// InputError for a command that is none.
std::string program_content(const std::string& detector);

/// How long the program may take, s.
struct ProcessLimits {
  double start = 600;   ///< until it serves: it loads its network, and may build it
  double answer = 300;  ///< for one frame
};

/// Starts the program and waits until it serves. One that is lost at a frame is started again and asked once
/// more, three times in all: then Failure. InputError naming the command if it cannot be started, ends before
/// it serves or speaks another protocol; later Failure for an error that it tells and for arrays of another
/// shape. It ends with the detector.
std::unique_ptr<Detector> start_program(const DetectorOptions& options, const ProcessLimits& limits = {});

}  // namespace mirage
