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

/// Those that `words` names, joined by commas: shipped ones by their words, others by their files (*.so);
/// none for "". InputError, naming it, for an unknown word, for a file that is no such plugin, and for two
/// sensors of one name.
std::vector<std::shared_ptr<const PluginSensor>> load_sensors(const std::string& words);

/// Whether a word names a sensor that ships.
bool is_shipped_sensor(const std::string& word);

/// Adds what these sensors measure of the whole frame, in their order, and gives what measures the same scene
/// with an object: PreparedFrame::measured_by is to hold it. `data`: the set that the frame is of; may be
/// empty. Failure if a plugin fails or gives a number that is not finite.
std::vector<std::shared_ptr<const SensorPass>> record(
    const std::vector<std::shared_ptr<const PluginSensor>>& sensors, const std::filesystem::path& data,
    Frame& frame);

/// Of the content of the plugins that `words` names; "" for none. Errors as load_sensors'.
std::string sensors_identity(const std::string& words);

}  // namespace mirage
