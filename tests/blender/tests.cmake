# The Blender add-on inside Blender; skipped with a message where Blender (or a display for the window) is missing.
add_executable(make_addon_scene blender/make_scene.cpp)
target_link_libraries(make_addon_scene PRIVATE mirage::exchange mirage_options)
add_test(NAME addon.scene_check COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/blender/test_glb_check.py
                                        ${PROJECT_SOURCE_DIR} $<TARGET_FILE:make_addon_scene>)
foreach(suite headless window)
  add_test(NAME addon.${suite} COMMAND ${MIRAGE_TEST_PYTHON} ${CMAKE_CURRENT_SOURCE_DIR}/blender/run.py ${suite}
                                       ${PROJECT_SOURCE_DIR} ${CMAKE_BINARY_DIR})
  set_tests_properties(addon.${suite} PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 600)
endforeach()
