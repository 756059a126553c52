# cmake --install: component `program` runs, component `development` builds other programs, `papers` are for readers.
# The program looks for its parts beside itself (base/files.h), so that a prefix can be moved.
set(parts lib/mirage)   # built: plugins, and weights beside them
set(data share/mirage)  # read: rigs, shapes, and the Python of the Blender worker and of the reports

install(TARGETS mirage RUNTIME DESTINATION bin COMPONENT program)
get_property(plugins GLOBAL PROPERTY MIRAGE_PLUGINS)
foreach(plugin ${plugins})
  install(TARGETS mirage_${plugin} LIBRARY DESTINATION ${parts}/plugins COMPONENT program)
  install(FILES ${CMAKE_BINARY_DIR}/plugins/${plugin}.json DESTINATION ${parts}/plugins COMPONENT program)
endforeach()
if(MIRAGE_DETECTORS)
  file(GLOB weights CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/plugins/*/*/weights/*.weights)
  install(FILES ${weights} ${PROJECT_SOURCE_DIR}/plugins/convert_weights.py DESTINATION ${parts}/plugins/weights COMPONENT program)
endif()
install(DIRECTORY ${PROJECT_SOURCE_DIR}/scenes DESTINATION ${data} COMPONENT program PATTERN *.jpg EXCLUDE)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/validation DESTINATION ${data} COMPONENT program
        FILES_MATCHING PATTERN *.py PATTERN *.toml PATTERN *.j2 PATTERN *.html PATTERN *.css PATTERN *.js
        PATTERN benchmarks EXCLUDE PATTERN studies EXCLUDE PATTERN __pycache__ EXCLUDE)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/plugins/blender/mirage_blender DESTINATION ${data}/plugins/blender
        COMPONENT program FILES_MATCHING PATTERN *.py PATTERN __pycache__ EXCLUDE)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/plugins/process DESTINATION ${parts}/plugins COMPONENT program
        FILES_MATCHING PATTERN mirage_serve.py PATTERN mirage_process.h)
install(FILES ${CMAKE_BINARY_DIR}/mirage.commit DESTINATION ${parts} COMPONENT program OPTIONAL)  # none of sources without git
# Fetched by the build, where npm was in reach.
install(FILES ${CMAKE_BINARY_DIR}/report/model-viewer.min.js DESTINATION ${parts}/report COMPONENT program OPTIONAL)
foreach(paper LICENSE NOTICE README.md CHANGELOG.md CITATION.cff)
  install(FILES ${PROJECT_SOURCE_DIR}/${paper} DESTINATION share/doc/mirage COMPONENT papers)
endforeach()

foreach(header ${headers})
  get_filename_component(folder ${header} DIRECTORY)
  install(FILES ${PROJECT_SOURCE_DIR}/src/${header} DESTINATION include/mirage/${folder} COMPONENT development)
endforeach()
set(config lib/cmake/Mirage)
foreach(layer ${layers})
  install(TARGETS mirage_${layer} EXPORT MirageTargets ARCHIVE DESTINATION lib COMPONENT development)
endforeach()
install(EXPORT MirageTargets NAMESPACE mirage:: DESTINATION ${config} COMPONENT development)
configure_package_config_file(MirageConfig.cmake.in ${CMAKE_CURRENT_BINARY_DIR}/MirageConfig.cmake
                              INSTALL_DESTINATION ${config} NO_SET_AND_CHECK_MACRO)
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/MirageConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/MirageConfig.cmake ${CMAKE_CURRENT_BINARY_DIR}/MirageConfigVersion.cmake
        DESTINATION ${config} COMPONENT development)
install(FILES ${PROJECT_SOURCE_DIR}/src/packages.cmake DESTINATION ${config} RENAME MiragePackages.cmake
        COMPONENT development)
