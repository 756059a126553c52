// One interface to the queries of Embree 3 and 4, which differ in nothing else used here. src/packages.cmake
// finds either, 4 first. Source: https://github.com/RenderKit/embree, "Upgrading from Embree 3 to Embree 4".
#pragma once

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace mirage {

/// Ray queries of a scene. One per thread, reusable; throws nothing. Rays are in the scene's frame and units;
/// a hit shortens `tfar`, an occluded ray has `tfar` = −∞.
class EmbreeQuery {
 public:
  /// `coherent`: the rays of a packet are close to each other, so that they traverse the tree together.
  explicit EmbreeQuery(bool coherent = false) {
#if RTC_VERSION_MAJOR == 3
    rtcInitIntersectContext(&settings_);
    if (coherent) settings_.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
#else
    rtcInitIntersectArguments(&settings_);
    if (coherent) settings_.flags = RTC_RAY_QUERY_FLAG_COHERENT;
#endif
  }

  /// Finds the nearest hit of one ray.
  void intersect(RTCScene scene, RTCRayHit& ray) {
    ask(rtcIntersect1, ray, scene);
  }
  /// Nearest hits of four rays. `valid`: one number for each ray of the packet, −1: traced, 0: skipped.
  void intersect(const int* valid, RTCScene scene, RTCRayHit4& packet) {
    ask(rtcIntersect4, packet, valid, scene);
  }
  /// The same for eight rays.
  void intersect(const int* valid, RTCScene scene, RTCRayHit8& packet) {
    ask(rtcIntersect8, packet, valid, scene);
  }
  /// The same for sixteen rays.
  void intersect(const int* valid, RTCScene scene, RTCRayHit16& packet) {
    ask(rtcIntersect16, packet, valid, scene);
  }
  /// Whether anything lies between the ray's ends; then its `tfar` is −∞.
  void occluded(RTCScene scene, RTCRay& ray) {
#if RTC_VERSION_MAJOR == 3
    rtcOccluded1(scene, &settings_, &ray);
#else
    RTCOccludedArguments settings;
    rtcInitOccludedArguments(&settings);
    rtcOccluded1(scene, &ray, &settings);
#endif
  }

 private:
#if RTC_VERSION_MAJOR == 3
  template <class Function, class Rays, class... Before>
  void ask(const Function& function, Rays& rays, Before... before) {
    function(before..., &settings_, &rays);
  }
  RTCIntersectContext settings_;
#else
  template <class Function, class Rays, class... Before>
  void ask(const Function& function, Rays& rays, Before... before) {
    function(before..., &rays, &settings_);
  }
  RTCIntersectArguments settings_;
#endif
};

}  // namespace mirage
