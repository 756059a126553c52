#include "exchange/host_proxy.h"

#include "scene/recorded_light.h"
#include "simulation/camera_pass.h"

namespace mirage {

Mesh ground_proxy(const Vec3d& centre, double reach) {
  Mesh ground;
  for (const Vec2d& corner :
       {Vec2d(reach, reach), Vec2d(-reach, reach), Vec2d(-reach, -reach), Vec2d(reach, -reach)})
    ground.vertices.push_back(centre + Vec3d(corner.x(), corner.y(), 0));
  ground.faces = {{0, 1, 2}, {0, 2, 3}};
  return ground;
}

ExportScene host_scene(const Frame& frame, const Placement& placement, const TexturedMesh& adversary,
                       const std::string& name) {
  ExportScene scene;
  scene.name = name;
  scene.adversary = place(adversary, placement);
  if (const auto& carrier = placement.carrier) {
    const Box3& box = carrier->label.box;
    const auto vehicle = shape_of(*carrier);
    const double ground = bounds(*vehicle).min().z();
    scene.proxies.push_back(
        {"host", carrier->shape ? "fitted" : "box", *vehicle, vehicle_paint(frame, carrier->label)});
    scene.proxies.push_back(
        {"ground", "", ground_proxy({box.bev.x, box.bev.y, ground}), Vec3d::Constant(kRoadAlbedo)});
  }
  scene.camera = frame.camera;
  scene.calibration = frame.calibration;
  scene.lighting = frame.lighting;
  scene.photograph = frame.image;
  for (const SideCamera& camera : frame.others)
    if (may_see(camera.calibration, scene.adversary.mesh, {})) scene.others.push_back(camera);
  return scene;
}

}  // namespace mirage
