# An installed prefix, moved, as others use it. Not under sanitizers, whose flags the consumer would have to share.
if(NOT MIRAGE_SANITIZE AND NOT MIRAGE_TSAN)
  add_test(NAME packages.installed COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/packages/installed.sh ${PROJECT_SOURCE_DIR}
                                           ${CMAKE_BINARY_DIR} ${CMAKE_COMMAND})
  set_tests_properties(packages.installed PROPERTIES TIMEOUT 600)
endif()

# The commit that lies beside the program.
add_test(NAME packages.commit COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/packages/commit.sh ${PROJECT_SOURCE_DIR} ${CMAKE_BINARY_DIR} ${CMAKE_COMMAND})
# What a newcomer's machine is asked, and what is told of it (make system-test).
add_test(NAME packages.system COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/packages/system.sh ${PROJECT_SOURCE_DIR})
set_tests_properties(packages.commit packages.system PROPERTIES SKIP_RETURN_CODE 77)

# What `make demo` installs is enough to configure what it builds; the tests are not left out in silence.
add_test(NAME packages.demo COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/packages/demo.sh ${PROJECT_SOURCE_DIR} ${CMAKE_COMMAND})
set_tests_properties(packages.demo PROPERTIES TIMEOUT 300)
