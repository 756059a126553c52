# Debian packages: cpack -G DEB in the build folder (make deb). The name `mirage` is an image viewer's in Debian.
set(CPACK_PACKAGE_NAME mirage-simulator)
set(CPACK_PACKAGE_VENDOR Mirage)
set(CPACK_PACKAGE_CONTACT "The authors of Mirage <mirage@example.org>")
set(CPACK_PACKAGE_DIRECTORY ${PROJECT_SOURCE_DIR}/build)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE
                                                WORLD_READ WORLD_EXECUTE)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL program development)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)

set(CPACK_DEBIAN_PROGRAM_PACKAGE_NAME mirage-simulator)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PROGRAM_PACKAGE_CONFLICTS mirage)  # has the same /usr/bin/mirage
# What `validate` and the reports need; without them everything else works. The demo shows all of it.
set(CPACK_DEBIAN_PROGRAM_PACKAGE_RECOMMENDS
    "blender, python3, python3-numpy, python3-jinja2, python3-pil, python3-matplotlib, libopenblas0-pthread | libopenblas0")
set(CPACK_DEBIAN_PROGRAM_PACKAGE_SUGGESTS "openmpi-bin, bash-completion")
set(CPACK_DEBIAN_PROGRAM_DESCRIPTION
    "adversarial objects against camera and LiDAR detectors
Mirage takes recorded or generated driving frames and learns one textured mesh
which, on the roof of any car in any scene, makes a camera and LiDAR detector
miss that car or see cars that are not there. Both sensors see the object
through differentiable simulation. It exports glTF and re-renders the scenes in
Blender Cycles to say whether the attack survives physically based light.
.
This package has the program, its detectors with their weights, and the scripts
of reports and of the Blender worker.")
# Debian's "-dev" packages of what src/packages.cmake finds.
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_NAME mirage-simulator-dev)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_DEPENDS
    "mirage-simulator, libeigen3-dev, libtbb-dev, libspdlog-dev, nlohmann-json3-dev, libopenmpi-dev, libtomlplusplus-dev, librandom123-dev, libboost-dev, libembree-dev, libhwy-dev, libceres-dev, libopencv-imgproc-dev, libnova-dev, libtinyxml2-dev, libpagmo-dev, liblcms2-dev, libtinygltf-dev, libturbojpeg0-dev")
set(CPACK_DEBIAN_DEVELOPMENT_DESCRIPTION
    "adversarial objects against camera and LiDAR detectors (development)
Mirage takes recorded or generated driving frames and learns one textured mesh
which, on the roof of any car in any scene, makes a camera and LiDAR detector
miss that car or see cars that are not there.
.
This package has the headers, the static libraries and the CMake package:
find_package(Mirage COMPONENTS scene) gives mirage::scene.")

# What Debian's policy wants of every package: its copyright and its changes.
foreach(component program development)
  string(TOUPPER ${component} upper)
  set(documents share/doc/${CPACK_DEBIAN_${upper}_PACKAGE_NAME})
  install(FILES debian/copyright DESTINATION ${documents} COMPONENT ${component})
  set(changelog ${CMAKE_CURRENT_BINARY_DIR}/${component}/changelog.gz)
  execute_process(COMMAND ${CMAKE_COMMAND} -E make_directory ${CMAKE_CURRENT_BINARY_DIR}/${component})
  execute_process(COMMAND gzip -9nc ${CMAKE_CURRENT_SOURCE_DIR}/debian/changelog OUTPUT_FILE ${changelog})
  install(FILES ${changelog} DESTINATION ${documents} COMPONENT ${component})
endforeach()
include(CPack)
