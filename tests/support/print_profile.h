// An ICC profile of a CMYK printer, as bytes.
#pragma once

#include <lcms2.h>

#include <array>
#include <stdexcept>
#include <string>
#include <vector>

#include "base/types.h"

namespace mirage::test {

/// Stores the XYZ (D50, perfect white 1) of the 16 overprints; cyan is the lowest bit of their index. Between
/// them ink areas mix (A2B1, a grid of 2). Colours have 16 bits relative to the paper's.
inline std::string print_profile(const std::vector<Vec3d>& overprints) {
  struct Said {
    const std::vector<Vec3d>& overprints;
    Vec3d paper;
  } said{overprints, overprints.at(0)};
  cmsHPROFILE profile = cmsCreateProfilePlaceholder(nullptr);
  cmsSetProfileVersion(profile, 4.2);
  cmsSetDeviceClass(profile, cmsSigOutputClass);
  cmsSetColorSpace(profile, cmsSigCmykData);
  cmsSetPCS(profile, cmsSigLabData);
  const cmsCIEXYZ white{said.paper.x(), said.paper.y(), said.paper.z()};
  cmsWriteTag(profile, cmsSigMediaWhitePointTag, &white);
  cmsPipeline* inks = cmsPipelineAlloc(nullptr, 4, 3);
  cmsStage* grid = cmsStageAllocCLut16bit(nullptr, 2, 4, 3, nullptr);
  cmsStageSampleCLut16bit(
      grid,
      [](const cmsUInt16Number in[], cmsUInt16Number out[], void* of) -> cmsInt32Number {
        const auto& colours = *static_cast<const Said*>(of);
        std::size_t which = 0;
        for (std::size_t k = 0; k < 4; ++k) which |= in[k] > 32767 ? std::size_t{1} << k : 0;
        const Vec3d d50(cmsD50_XYZ()->X, cmsD50_XYZ()->Y, cmsD50_XYZ()->Z),
            relative = colours.overprints.at(which).cwiseQuotient(colours.paper).cwiseProduct(d50);
        const cmsCIEXYZ xyz{relative.x(), relative.y(), relative.z()};
        cmsCIELab lab;
        cmsXYZ2Lab(nullptr, &lab, &xyz);
        cmsFloat2LabEncoded(out, &lab);
        return TRUE;
      },
      &said, 0);
  cmsPipelineInsertStage(inks, cmsAT_BEGIN, cmsStageAllocToneCurves(nullptr, 4, nullptr));
  cmsPipelineInsertStage(inks, cmsAT_END, grid);
  cmsPipelineInsertStage(inks, cmsAT_END, cmsStageAllocToneCurves(nullptr, 3, nullptr));
  cmsWriteTag(profile, cmsSigAToB1Tag, inks);
  cmsWriteTag(profile, cmsSigAToB0Tag, inks);
  cmsPipelineFree(inks);
  cmsUInt32Number size = 0;
  std::string bytes;
  bool good = cmsSaveProfileToMem(profile, nullptr, &size);
  bytes.resize(size);
  good = good && cmsSaveProfileToMem(profile, bytes.data(), &size);
  cmsCloseProfile(profile);
  if (!good) throw std::runtime_error("Little CMS writes no profile");
  return bytes;
}

}  // namespace mirage::test
