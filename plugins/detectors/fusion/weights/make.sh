#!/bin/sh
# How the weights in this folder, and those of guided-depth, were made: make.sh YOLOX, a TorchScript file of YOLOX-nano trained on
# COCO. Writes to out. A command that was stopped continues from its checkpoint when it is run again. The sets differ a little in the
# generator's version, so the same commands give weights of like AP, not the same bits.
set -e
YOLOX=$1
W=plugins/detectors/fusion/weights

# The KITTI rig
mirage generate --rig kitti64 --frames 420 --seed 1 --truth --out out/kitti64-train
mirage generate --rig kitti64 --start 600 --frames 80 --seed 1 --truth --out out/kitti64-train
mirage generate --rig kitti64 --start 1000 --frames 2300 --seed 1 --out out/kitti64-second
train="mirage train --data out/kitti64-train --precision bfloat16 --threads 1"
$train --detector lidar --steps 2694 --learning-rate 2e-3 --frames 300 --out out/lidar0
$train --detector camera --steps 870 --learning-rate 3e-3 --frames 500 --start "$YOLOX" --out out/camera
$train --detector lidar --steps 2600 --learning-rate 1.2e-3 --frames 500 --start out/lidar0/lidar.weights --out out/lidar1
for detector in fusion painted; do
  $train --detector $detector --steps 2600 --learning-rate 1.2e-3 --frames 500 --start out/lidar0/lidar.weights \
    --camera out/camera/camera.weights --out out/${detector}1
done
# The shipped camera
$train --detector camera --steps 1500 --learning-rate 7e-4 --frames 500 --heads --keep-start 0.25 --start out/camera/camera.weights \
  --out out/heads
second="mirage train --data out/kitti64-second --precision bfloat16 --threads 1 --learning-rate 2e-3"
$second --detector late --steps 2300 --lidar out/lidar1/lidar.weights --camera out/heads/camera.weights --out out/late1
$second --detector refined --steps 12000 --start $W/fusion-kitti64.weights --out out/second

# The rig xenith starts from the KITTI rig's weights
mirage generate --rig xenith --frames 240 --seed 1 --truth --out out/xenith-train
mirage generate --rig xenith --frames 420 --seed 1 --truth --out out/xenith-heads
mirage generate --rig xenith --start 1000 --frames 400 --seed 1 --out out/xenith-second
train="mirage train --data out/xenith-train --frames 240 --precision bfloat16 --threads 1"
$train --detector lidar --steps 900 --learning-rate 1.2e-3 --start $W/lidar-kitti64.weights --out out/x-lidar
$train --detector camera --steps 250 --learning-rate 1e-3 --start $W/camera-kitti64.weights --out out/x-camera
for detector in fusion painted; do
  $train --detector $detector --steps 900 --learning-rate 1.2e-3 --start $W/$detector-kitti64.weights \
    --camera out/x-camera/camera.weights --out out/x-$detector
done
mirage train --data out/xenith-heads --threads 1 --detector camera --steps 700 --learning-rate 7e-4 --frames 420 --heads --keep-start 0.25 \
  --start out/x-camera/camera.weights --out out/x-heads
mirage train --data out/xenith-second --frames 240 --threads 1 --detector late --steps 720 --learning-rate 2e-3 \
  --lidar out/x-lidar/lidar.weights --camera out/x-heads/camera.weights --out out/x-late
mirage train --data out/xenith-second --precision bfloat16 --threads 1 --detector refined --steps 2500 --learning-rate 2e-3 \
  --start $W/fusion-xenith.weights --out out/x-second

# Learned depth (guided, 0.40 M parameters)
mirage generate --rig kitti64 --frames 120 --seed 11 --depth --out out/depth-train
mirage train depth --data out/depth-train --steps 4000 --threads 1 --out out/depth1
mirage train depth --data out/depth-train --start out/depth1/guided-depth.weights --steps 900 --learning-rate 8e-4 --without-picture 0.2 \
  --scatter 0.4 --seed 1 --threads 1 --out out/depth2
