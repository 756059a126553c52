# A disk that fails, kills at any moment, ranks, Blender: a part of it here, all of it by make faults.
if(MIRAGE_SANITIZE OR MIRAGE_TSAN)
  return()  # their run-time libraries must be the first that is loaded
endif()
add_library(mirage_faults MODULE ${CMAKE_CURRENT_SOURCE_DIR}/faults/injector.cpp)
target_link_libraries(mirage_faults PRIVATE ${CMAKE_DL_LIBS})
target_compile_options(mirage_faults PRIVATE -Wall -Wextra -Wpedantic -Wshadow -Werror)
set_target_properties(mirage_faults PROPERTIES LIBRARY_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/test_plugins)
mirage_python_test(faults.quick faults/run.py --quick)
mirage_python_test(faults.refusals faults/refusals.py --quick)
