# An installed prefix, moved, as others use it. Not under sanitizers, whose flags the consumer would have to share.
if(NOT MIRAGE_SANITIZE AND NOT MIRAGE_TSAN)
  add_test(NAME packages.installed COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/packages/installed.sh ${PROJECT_SOURCE_DIR}
                                           ${CMAKE_BINARY_DIR} ${CMAKE_COMMAND})
  set_tests_properties(packages.installed PROPERTIES TIMEOUT 600)
endif()

# What `make demo` installs is enough to configure what it builds; the tests are not left out in silence.
add_test(NAME packages.demo COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/packages/demo.sh ${PROJECT_SOURCE_DIR} ${CMAKE_COMMAND})
set_tests_properties(packages.demo PROPERTIES TIMEOUT 300)
