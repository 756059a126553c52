// The source of frames and the preparation of their scenes before anything is inserted.
#pragma once

#include <filesystem>
#include <string>

#include "base/fields.h"
#include "scene/data/data_rig.h"
#include "scene/data/data_set.h"
#include "scene/depth/learned_depth.h"
#include "scene/place_choice.h"
#include "scene/recorded_light.h"
#include "scene/shape/shape_fit.h"

namespace mirage {

/// A data set and how its frames are prepared.
struct FrameSource {
  std::filesystem::path data = {};     ///< a layout of scene/data/data_set.h
  std::string depth = kDefaultDepth;   ///< depth completion of the photographs (learned_depth.h)
  std::string rooftop = kDefaultRoof;  ///< the roof finder (shape/shape_fit.h)
  std::string sun = kDefaultSun;       ///< the sun's direction (recorded_light.h)
  std::string rig = {};                ///< as data_rig.h takes it; empty: the set's own
  PlaceChoice placement = {};          ///< of the object (place_choice.h)
  Cameras cameras = Cameras::first;    ///< the cameras used
  std::string sensors = {};            ///< more sensors: plugins of simulation/sensor_plugin.h, by commas
  std::string classes = kCars;         ///< of labels that carry the object and must be found (classes_of)
};

template <class Visitor, FieldsOf<FrameSource> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "data",
         .help = "data set: KITTI's object, tracking or raw layout, or nuScenes",
         .required = true},
        s.data);
  visit({.name = "rig", .help = kRigHelp, .lacking = ""}, s.rig);
  visit({.name = "depth",
         .help = "depth completion of the photographs: ip-basic, guided (learned) or a plugin (*.so)"},
        s.depth);
  visit({.name = "rooftop",
         .help = "roof that the object stands on: shape (fitted to the vehicle's returns), box (top of the "
                 "labelled box) or a shape model to fit (*.shape)"},
        s.rooftop);
  visit({.name = "placement",
         .help = "where the object is put: a shipped placement, FILE.toml, X,Y,Z,YAW or world:X,Y,Z,YAW. "
                 "X, Y, Z: m forward, left and up from the ground under the host; YAW: degrees from its "
                 "heading; world: in the LiDAR's frame",
         .option = "place",
         .lacking = "roof"},
        s.placement);
  visit({.name = "cameras",
         .help = "for data sets with several cameras (nuScenes): first (the front camera, and the part of "
                 "the sweep in its view) or all (every camera, and the whole sweep)",
         .lacking = "first"},
        s.cameras);
  visit({.name = "sensors",
         .help = "sensors beside cameras and LiDAR, as radar,FILE.so: shipped ones (radar, an example) or "
                 "plugins (*.so); detectors read them by name",
         .lacking = ""},
        s.sensors);
  visit({.name = "classes",
         .help = kClassesHelp,
         .lacking = kCars,
         .check = [](const std::string& list) { classes_of(list); }},
        s.classes);
  visit({.name = "sun",
         .help = "where the sun stands: frame (the frame's own lighting), photo (from its shadows), "
                 "AZIMUTH,ELEVATION (degrees; azimuth counter-clockwise from forward) or "
                 "LAT,LON,YYYY-MM-DDTHH:MM:SSZ,HEADING (degrees; heading counter-clockwise from east)",
         .check = [](const std::string& word) { parse_sun(word); }},
        s.sun);
}

}  // namespace mirage
