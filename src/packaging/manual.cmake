# Pages for `man` and words for bash's completion, both made from the command tree of the program itself.
set(completion ${CMAKE_BINARY_DIR}/completion/mirage)
add_custom_command(OUTPUT ${completion} COMMAND ${CMAKE_COMMAND} -E make_directory ${CMAKE_BINARY_DIR}/completion
                   COMMAND ${CMAKE_COMMAND} -E env ASAN_OPTIONS=detect_leaks=0:verify_asan_link_order=0 $<TARGET_FILE:mirage>
                           --completion bash > ${completion}
                   DEPENDS mirage VERBATIM)
add_custom_target(completion ALL DEPENDS ${completion})
install(FILES ${completion} DESTINATION share/bash-completion/completions COMPONENT program)

# Needs help2man: `make manual` and `make deb` install it.
find_program(MIRAGE_HELP2MAN help2man)
set(manual ${CMAKE_BINARY_DIR}/man/man1)
add_custom_command(OUTPUT ${manual}/mirage.1.gz
                   COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/manual.sh $<TARGET_FILE:mirage> ${MIRAGE_HELP2MAN} ${manual} ${PROJECT_VERSION}
                   DEPENDS mirage manual.sh VERBATIM)
add_custom_target(manual DEPENDS ${manual}/mirage.1.gz)
install(DIRECTORY ${manual} DESTINATION share/man COMPONENT program OPTIONAL)
