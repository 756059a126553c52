// Sensors that are neither cameras nor LiDARs, from shared libraries (sensor_abi.h).
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "simulation/sensor_pass.h"

namespace mirage {

/// A sensor of a plugin.
class PluginSensor;

/// Loads the sensors in `words`, joined by commas: shipped ones by their words, others by their files (*.so);
/// none for "". InputError, naming it, for an unknown word, for a file that is not a sensor plugin, and for
/// two sensors of one name.
std::vector<std::shared_ptr<const PluginSensor>> load_sensors(const std::string& words);

/// Whether a word names a shipped sensor.
bool is_shipped_sensor(const std::string& word);

/// Adds these sensors' measurements of the whole frame, in their order. Returns the passes that measure the
/// same scene with an object, for PreparedFrame::measured_by. `data`: the frame's data set; may be empty.
/// Failure if a plugin fails or gives a number that is not finite.
std::vector<std::shared_ptr<const SensorPass>> record(
    const std::vector<std::shared_ptr<const PluginSensor>>& sensors, const std::filesystem::path& data,
    Frame& frame);

/// Hash of the content of the plugins that `words` names; "" for none. Errors as load_sensors'.
std::string sensors_identity(const std::string& words);

}  // namespace mirage
