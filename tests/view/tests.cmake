# The page of mirage view in headless Chromium; skipped with a message where Chromium is missing.
add_test(NAME view.page COMMAND ${MIRAGE_TEST_PYTHON} -B ${CMAKE_CURRENT_SOURCE_DIR}/view/test_view.py
                                ${PROJECT_SOURCE_DIR} ${CMAKE_BINARY_DIR})
set_tests_properties(view.page PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 900)
